#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Looks at the report of a reconstruction in a real browser: Chromium without a window draws it at desktop and at phone
# width, turns the surface by its address, by mouse and by finger, and prints it.
#   run.sh PROGRAM [FOLDER] [REPORT]
# PROGRAM  satsurf
# FOLDER   to keep screenshots in, desktop.png, phone.png, print.pdf and others, to be looked at; else they are thrown away
# REPORT   report.html of a run to look at, instead of one of a small simulated scene
# Without chromium (Debian: chromium) or oiiotool (openimageio-tools) it says that it is skipped and succeeds.
set -uo pipefail
satsurf=$(realpath "$1")
for needed in chromium oiiotool; do
  if ! command -v $needed >/dev/null; then
    echo "SKIPPED: no $needed"
    exit 0
  fi
done
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
shots=${2:-$work/shots}
mkdir -p "$shots"
shots=$(realpath "$shots")
[ $# -ge 3 ] && given=$(realpath "$3")
cd "$work" || exit 1
checks=0 failures=0
holds() { # NAME COMMAND...
  checks=$((checks + 1))
  local name=$1
  shift
  "$@" >/dev/null 2>&1 || {
    failures=$((failures + 1))
    echo "FAIL: $name"
  }
}

if [ $# -ge 3 ]; then
  mkdir run && cp "$given" run/report.html
else
  "$satsurf" simulate --out data --scenes 1 --views 3 --pixels 192 --seed 7 --quiet &&
    "$satsurf" reconstruct data/Track3-RGB/*.tif --out run --quiet >/dev/null || exit 1
fi
page="file://$work/run/report.html"

browser() { # OPTIONS... ADDRESS
  timeout 120 chromium --headless --no-sandbox --disable-gpu --use-angle=swiftshader --enable-unsafe-swiftshader \
    --hide-scrollbars --disable-background-networking --disable-component-update --no-first-run \
    --user-data-dir="$work/profile" --force-color-profile=srgb --virtual-time-budget=5000 "$@" 2>>"$work/browser.log"
}
# The page with a script at its end that acts on it; the state is read from what the browser then has.
with_script() { # NAME SCRIPT
  sed "s#</body>#<script>addEventListener('load', () => setTimeout(() => { $2 }, 300));</script></body>#" run/report.html >"run/$1.html"
}
shot() { # NAME WIDTH HEIGHT ADDRESS
  browser --window-size="$2,$3" --screenshot="$shots/$1.png" "$4" >/dev/null
}
# a hundredth of the pixels of two screenshots or more are not the same
differ() { # A B
  ! oiiotool --fail 0.05 --failpercent 1 --diff "$shots/$1.png" "$shots/$2.png"
}

# --- it draws, at desktop and phone width ----------------------------------------------------------------------------
shot desktop 1280 4600 "$page"
holds "a screenshot at desktop width" test -s "$shots/desktop.png"
# Chromium has no window narrower than 500 px; a frame may have any width.
cat >phone.html <<END
<!DOCTYPE html><body style="margin:0"><iframe src="run/report.html" style="border:0;width:390px;height:8000px"></iframe>
END
shot phone 500 8000 "file://$work/phone.html"
holds "a screenshot at phone width" test -s "$shots/phone.png"
# What is wider than the page is told to the page around the frame.
with_script measure "parent.postMessage([...document.querySelectorAll('body *')].filter((e) => e.getBoundingClientRect().right > innerWidth + 1 \&\& !e.closest('.scroll, svg, .scale')).length, '*')"
for width in 320 390 1280; do
  cat >measure.html <<END
<!DOCTYPE html><title>none</title><script>onmessage = (e) => document.title = 'wider: ' + e.data;</script>
<iframe src="run/measure.html" style="border:0;width:${width}px;height:800px"></iframe>
END
  browser --dump-dom "file://$work/measure.html" >measure.txt
  holds "nothing is wider than a page of $width px" grep -q "<title>wider: 0</title>" measure.txt
done

# --- the surface is there and turns ----------------------------------------------------------------------------------
for try in 1 2 3; do # a busy machine may end the page's five seconds before its first frame
  browser --dump-dom "$page#turn=40&tilt=30" >there.txt
  grep -q 'data-drawn=' there.txt && break
done
holds "the surface is drawn" grep -qE '<canvas id="view"[^>]* data-turn="40"[^>]* data-drawn=' there.txt
holds "WebGL is there" bash -c "! grep -qE '<body[^>]*no-webgl' there.txt"
shot turn0 1280 900 "$page#turn=0&tilt=35"
shot turn70 1280 900 "$page#turn=70&tilt=35"
holds "turned, it looks another" differ turn0 turn70
shot heights 1280 900 "$page#turn=0&tilt=35&drape=heights"
holds "draped with heights, too" differ turn0 heights
# From the lowest row and column of the picture that the surface covers to the highest: their larger share of the window.
with_script fill "const c = document.getElementById('view'), g = c.getContext('webgl'), w = g.drawingBufferWidth, h = g.drawingBufferHeight, p = new Uint8Array(4 * w * h); g.readPixels(0, 0, w, h, g.RGBA, g.UNSIGNED_BYTE, p); let x0 = w, x1 = 0, y0 = h, y1 = 0; for (let i = 0; i < w * h; ++i) if (p[4 * i + 3]) x0 = Math.min(x0, i % w), x1 = Math.max(x1, i % w), y0 = Math.min(y0, i / w | 0), y1 = Math.max(y1, i / w | 0); document.title = 'fills: ' + Math.round(100 * Math.max((x1 - x0) / w, (y1 - y0) / h)); parent.postMessage(document.title, '*')"
for width in 390 1280; do
  cat >fill.html <<END
<!DOCTYPE html><title>none</title><script>onmessage = (e) => document.title = e.data;</script>
<iframe src="run/fill.html" style="border:0;width:${width}px;height:800px"></iframe>
END
  browser --dump-dom "file://$work/fill.html" >fill.txt
  holds "the surface fills its window on a page of $width px" grep -qE "<title>fills: (8[5-9]|9[0-9])</title>" fill.txt
done
drag() { # TYPE
  echo "const c = document.getElementById('view'); const f = (n, x, y) => c.dispatchEvent(new PointerEvent(n, {pointerId: 1, pointerType: '$1', clientX: x, clientY: y, bubbles: true})); f('pointerdown', 300, 300); f('pointermove', 400, 320); f('pointerup', 400, 320);"
}
for type in mouse touch; do
  with_script $type "$(drag $type)"
  browser --dump-dom "file://$work/run/$type.html#turn=0&tilt=40" >$type.txt
  holds "$type: 100 px turn it by 40 degrees, 20 px tilt it by 6" grep -qE 'data-turn="40" data-tilt="46"' $type.txt
done
with_script keys "const c = document.getElementById('view'); c.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight'}));"
browser --dump-dom "file://$work/run/keys.html#turn=0&tilt=40" >keys.txt
holds "so do keys" grep -qE 'data-turn="5" data-tilt="40"' keys.txt
timeout 120 chromium --headless --no-sandbox --disable-gpu --disable-3d-apis --no-first-run --user-data-dir="$work/plain" \
  --virtual-time-budget=3000 --dump-dom "$page" >plain.txt 2>>browser.log
holds "without WebGL a text says so" grep -qE '<body class="no-webgl"' plain.txt

# --- it asks for nothing ---------------------------------------------------------------------------------------------
asked() { # NAME: names of other places that a browser with this page asked for
  browser --log-net-log="$work/net.json" --dump-dom "file://$work/run/$1.html" >/dev/null
  grep -oE '"url":"(http|ws|ftp)[^"]*"' net.json | grep -vE 'google|gvt1|chromium' # the browser's own
}
sed 's#<meta http-equiv[^>]*>##; s#</body>#<img src="http://127.0.0.1:9/x.png"></body>#' <(tr '\n' ' ' <run/report.html) >run/asking.html
holds "a page that asks is found out" test -n "$(asked asking)"
holds "this one asks for nothing" test -z "$(asked report)"
holds "no script complained" bash -c "! grep -E 'CONSOLE|Refused to' browser.log"

# --- on paper --------------------------------------------------------------------------------------------------------
browser --no-pdf-header-footer --print-to-pdf="$shots/print.pdf" "$page" >/dev/null
with_script paper "dispatchEvent(new Event('beforeprint')); document.title = 'closed: ' + document.querySelectorAll('details:not([open])').length; dispatchEvent(new Event('afterprint')); document.title += ', then ' + document.querySelectorAll('details:not([open])').length"
browser --dump-dom "file://$work/run/paper.html" >paper.txt
holds "what is closed is printed open" grep -q "<title>closed: 0, then 1</title>" paper.txt
holds "it prints" test "$(stat -c %s "$shots/print.pdf")" -gt 100000
holds "it is smaller than 3 MB" test "$(stat -c %s run/report.html)" -lt 3000000

echo "$checks checks, $failures failures"
[ "$failures" -eq 0 ]
