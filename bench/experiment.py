#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Trains the method, its ablations and other methods on the same simulated scenes for the same number of steps, scores
them on the same held-out scenes and writes the table.

  bench/experiment.py OUT [--steps 1000] [--seeds 1 2] [--only REGEX] [--lpips FILE] [--satsurf build/release/bin/satsurf]

Goes on where it stopped: whatever OUT already holds is not made again. OUT/experiment.json is the configuration; another
one needs another OUT. OUT/table.md and OUT/table.json hold the scores, means over scenes and seeds with the spread of
the seeds, and what the whole method gains over each other variant, seed by seed: `ahead` or `behind` where the mean gain
exceeds what separates the seeds, else `undecided`. Runs go side by side, a core each: that takes a fifth less time than
one after the other, and any number of threads gives the same bits. The monocular branch is that of --mono, for all that
have one.
"""
import argparse
import concurrent.futures
import csv
import hashlib
import json
import math
import os
import re
import subprocess
import sys
import threading

# What differs from the whole method, by name. Every variant has the same steps, crops, learning rate and data.
VARIANTS = {
    'full': ['--preset', 'base8'],
    'no fusion': ['--preset', 'base8', '--model.fusion', 'none'],
    'naive fusion': ['--preset', 'base8', '--model.fusion', 'naive'],
    'no guidance': ['--preset', 'base8', '--model.guidance', 'none'],
    'no routing': ['--preset', 'base8', '--routing', 'none'],
    'no fusion, no guidance': ['--preset', 'base8', '--model.fusion', 'none', '--model.guidance', 'none'],
    'no fusion, no routing': ['--preset', 'base8', '--model.fusion', 'none', '--routing', 'none'],
    'no guidance, no routing': ['--preset', 'base8', '--model.guidance', 'none', '--routing', 'none'],
    'none of the three': ['--preset', 'base8', '--model.fusion', 'none', '--model.guidance', 'none', '--routing', 'none'],
    'paper': ['--preset', 'paper'],
    'mvsplat_like': ['--preset', 'mvsplat_like'],
    'hisplat_like': ['--preset', 'hisplat_like'],
    'skysplat_like': ['--preset', 'skysplat_like'],
}

# Columns of the table: key of the mean in evaluate's JSON, title, factor, digits, whether less is better.
COLUMNS = [
    ('render_target_mae', 'target MAE m', 1, 3, True),
    ('render_target_pag2.5', 'target < 2.5 m %', 100, 1, False),
    ('render_target_psnr', 'PSNR dB', 1, 2, False),
    ('render_target_psnr_fitted', 'PSNR fitted dB', 1, 2, False),
    ('render_target_ssim', 'SSIM', 1, 3, False),
    ('render_target_lpips', 'LPIPS', 1, 3, True),
    ('mvs_source_mae', 'source MAE m', 1, 3, True),
    ('dsm_mae', 'DSM MAE m', 1, 3, True),
    ('dsm_pag2.5', 'DSM < 2.5 m %', 100, 1, False),
    ('mesh_chamfer', 'chamfer m', 1, 3, True),
    ('mesh_f1_1', 'F1 1 m %', 100, 1, False),
    ('dsm_completeness', 'DSM complete %', 100, 1, False),
]


CORES = len(os.sched_getaffinity(0))
PRINTING = threading.Lock()


def run(command, log):
    """Runs a program; what it says is added to a file."""
    with PRINTING:
        print('+', ' '.join(command), flush=True)
    with open(log, 'a', encoding='utf-8') as out:
        out.write('+ ' + ' '.join(command) + '\n')
        out.flush()
        code = subprocess.run(command, stdout=out, stderr=out).returncode
    if code != 0:
        raise RuntimeError(f'{command[0]} {command[1]} failed with {code}; see {log}')


def done(folder, steps):
    """Whether a training run there has taken all its steps."""
    try:
        with open(os.path.join(folder, 'train.jsonl'), encoding='utf-8') as lines:
            last = json.loads(lines.read().splitlines()[-1])
    except (OSError, IndexError, ValueError):
        return False
    return last['step'] >= steps and os.path.exists(os.path.join(folder, 'weights.safetensors'))


def train(satsurf, out, steps, arguments, log):
    if done(out, steps):
        return
    resume = ['--resume'] if os.path.exists(os.path.join(out, 'checkpoint.safetensors')) else ['--overwrite']
    run([satsurf, 'train', '--out', out, '--steps', str(steps), *arguments, *resume], log)


def identity(path):
    """What a file is, wherever it lies; nothing for no file."""
    if not path:
        return ''
    with open(path, 'rb') as f:
        return f'{os.path.basename(path)} sha256:{hashlib.sha256(f.read()).hexdigest()[:16]}'


def file_name(variant):
    return re.sub(r'[^a-z0-9_]+', '-', variant)


def cell(values, factor, digits):
    if not values:
        return '-'
    mean = factor * sum(values) / len(values)
    if len(values) == 1:
        return f'{mean:.{digits}f}'
    half = factor * (max(values) - min(values)) / 2
    return f'{mean:.{digits}f} ± {half:.{digits}f}'


def compare(full, other, column):
    """In words: the whole method against another variant, both [(mean row, scene rows)] of the same seeds, in one
    column. Seed by seed and scene by scene, both saw the same crops and are scored on the same images, so what seeds
    and scenes do to either cancels: the gain is a mean of differences, of errors of their logarithms, as else the hardest
    scene would outweigh all others, told as the share of the other's error that is saved."""
    key, title, factor, digits, less = column
    pairs = [[(a[key], b[key]) for a, b in zip(x, y) if key in a and key in b and (not less or min(a[key], b[key]) > 0)]
             for (_, x), (_, y) in zip(full, other)]
    if not pairs or not all(pairs):
        return None
    differences = [[math.log(b / a) if less else a - b for a, b in seed] for seed in pairs]
    gains = [sum(d) / len(d) for d in differences]
    if less:
        gains, factor, digits, unit = [1 - math.exp(-g) for g in gains], 100, 1, ' %'
    else:
        unit = ''
    gains = [factor * g for g in gains]
    gain, spread = sum(gains) / len(gains), max(gains) - min(gains)
    word = 'one seed' if len(gains) == 1 else 'ahead' if gain > spread else 'behind' if gain < -spread else 'undecided'
    each = ', '.join(f'{g:+.{digits}f}{unit}' for g in gains)
    ahead, scenes = sum(d > 0 for seed in differences for d in seed), sum(map(len, differences))
    return f'{title}: {word} ({each}; {ahead} of {scenes} scenes)'


def write_table(out, config, scores):
    """scores: {variant: {seed: (mean row, scene rows) of evaluate}}"""
    lines = ['| variant | ' + ' | '.join(title for _, title, *_ in COLUMNS) + ' |',
             '|---' * (len(COLUMNS) + 1) + '|']
    for variant, runs in scores.items():
        cells = [cell([m[key] for m, _ in runs.values() if key in m], factor, digits) for key, _, factor, digits, _ in COLUMNS]
        lines.append(f'| {variant} | ' + ' | '.join(cells) + ' |')
    lines.append('')
    for variant, runs in scores.items():
        if variant != 'full' and 'full' in scores:
            seeds = [k for k in runs if k in scores['full']]
            verdicts = [compare([scores['full'][k] for k in seeds], [runs[k] for k in seeds], column)
                        for column in COLUMNS]
            lines.append(f'- full against {variant}: ' + '; '.join(v for v in verdicts if v))
    with open(os.path.join(out, 'table.md'), 'w', encoding='utf-8') as f:
        f.write('\n'.join(lines) + '\n')
    with open(os.path.join(out, 'table.json'), 'w', encoding='utf-8') as f:
        json.dump({'experiment': config,
                   'scores': {v: {k: {'mean': m, 'scenes': rows} for k, (m, rows) in runs.items()}
                              for v, runs in scores.items()}},
                  f, indent=2)
    print('\n'.join(lines), flush=True)


def read_scores(path):
    """Mean row and scene rows of a table of evaluate; numbers that do not exist are left out."""
    with open(path, encoding='utf-8', newline='') as f:
        rows = list(csv.DictReader(f))
    numbers = [{k: float(v) for k, v in row.items() if k != 'scene' and v} for row in rows]
    if not rows or rows[-1]['scene'] != 'mean':
        raise RuntimeError(f'{path}: no mean in the last row')
    return numbers[-1], numbers[:-1]


def main():
    root = os.path.join(os.path.dirname(os.path.abspath(__file__)), '..')
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('out', metavar='OUT', help='folder of everything')
    parser.add_argument('--satsurf', default=os.path.join(root, 'build/release/bin/satsurf'))
    parser.add_argument('--steps', type=int, default=1000, help='of every variant')
    parser.add_argument('--crop', type=int, default=96, help='side of the training windows, px')
    parser.add_argument('--scenes', type=int, default=64, help='to train on')
    parser.add_argument('--heldout', type=int, default=12, help='scenes to score on')
    parser.add_argument('--pixels', type=int, default=384, help='rows and columns of the images')
    parser.add_argument('--mono', default=os.path.join(root, 'nn/weights/mono12.safetensors'),
                        help='weights of the monocular branch')
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2])
    parser.add_argument('--lpips', default='', help='LPIPS weights, for the loss and the score; neither without')
    parser.add_argument('--only', default='', help='variants whose name this regular expression finds')
    parser.add_argument('--jobs', type=int, default=CORES, help='runs side by side')
    arguments = parser.parse_args()
    if not os.access(arguments.satsurf, os.X_OK):
        sys.exit(f'experiment.py: no program {arguments.satsurf}; build satsurf or name it with --satsurf')

    out = arguments.out
    os.makedirs(os.path.join(out, 'scores'), exist_ok=True)
    config = {k: getattr(arguments, k) for k in ('steps', 'crop', 'scenes', 'heldout', 'pixels')}
    config |= {k: identity(getattr(arguments, k)) for k in ('mono', 'lpips')}
    recorded = os.path.join(out, 'experiment.json')
    if os.path.exists(recorded):
        with open(recorded, encoding='utf-8') as f:
            before = json.load(f)
        if before != config:
            sys.exit(f'experiment.py: {recorded} is of another experiment: {before}, wanted {config}; '
                     'give another OUT')
    with open(recorded, 'w', encoding='utf-8') as f:
        json.dump(config, f, indent=2)

    threads = ['--threads', str(max(1, CORES // arguments.jobs))]
    satsurf, data, heldout = arguments.satsurf, os.path.join(out, 'train'), os.path.join(out, 'heldout')
    for folder, scenes, seed in ((data, arguments.scenes, 101), (heldout, arguments.heldout, 202)):
        if not os.path.exists(os.path.join(folder, 'run.json')):
            run([satsurf, 'simulate', '--out', folder, '--scenes', str(scenes), '--pixels', str(arguments.pixels),
                 '--seed', str(seed), '--overwrite'], os.path.join(out, 'simulate.log'))
    lpips = ['--lpips_weights', arguments.lpips] if arguments.lpips else []

    def score(variant, seed):
        """What evaluate finds on the held-out scenes, see `read_scores`."""
        name = f'{file_name(variant)}-{seed}'
        folder, result = os.path.join(out, 'runs', name), os.path.join(out, 'scores', name + '.csv')
        log = os.path.join(out, 'runs', name + '.log')
        if not os.path.exists(result):
            train(satsurf, folder, arguments.steps,
                  [*VARIANTS[variant], '--data', data, '--seed', str(seed), '--crop', str(arguments.crop),
                   '--mono_weights', arguments.mono, *lpips, *threads], log)
            run([satsurf, 'evaluate', '--data', heldout, '--weights', os.path.join(folder, 'weights.safetensors'),
                 '--csv', result, *threads, *(['--lpips-weights', arguments.lpips] if arguments.lpips else [])], log)
        return read_scores(result)

    os.makedirs(os.path.join(out, 'runs'), exist_ok=True)
    scores = {}
    variants = [v for v in VARIANTS if re.search(arguments.only, v)]
    with concurrent.futures.ThreadPoolExecutor(arguments.jobs) as pool:
        # seed by seed: a table of one seed is there early
        runs = {pool.submit(score, v, seed): (v, seed) for seed in arguments.seeds for v in variants}
        try:
            for finished in concurrent.futures.as_completed(runs):
                variant, seed = runs[finished]
                scores.setdefault(variant, {})[seed] = finished.result()
                with PRINTING:
                    write_table(out, {**config, 'seeds': arguments.seeds},
                                {v: dict(sorted(scores[v].items())) for v in variants if v in scores})
        except (RuntimeError, OSError) as e:
            for other in runs:
                other.cancel()
            sys.exit(f'experiment.py: {e}')


if __name__ == '__main__':
    main()
