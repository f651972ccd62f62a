#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Prints the JSON files of satsurf-bench as the Markdown tables of results.md.

  bench/table.py ONE_THREAD.json TWO_THREADS.json
"""
import json
import re
import sys


def read(path):
    with open(path, encoding='utf-8') as f:
        data = json.load(f)
    # the median where a row was repeated
    rows = {}
    for b in data['benchmarks']:
        if b.get('run_type') != 'aggregate' or b.get('aggregate_name') == 'median':
            rows[b.get('run_name', b['name'])] = b
    return data['context'], rows


def share(row):
    return f'{100 * row["share"]:.0f} % {row.get("label", "")}'.strip() if row.get('share') else '-'


def milliseconds(row):
    return f'{row["real_time"]:.3g}' if row else '-'


def operators(files):
    shapes = {}
    for i, (_, rows) in enumerate(files):
        for name, row in rows.items():
            match = re.match(r'(\w+?)_fwd(_bwd)?/(.*)', name)
            if match and not name.startswith('splat'):
                key = f'{match[1]}/{match[3]}'
                shapes.setdefault(key, {})[(i, bool(match[2]))] = row
    threads = [c['threads'] for c, _ in files]
    print('| row | ' + ' | '.join(f'{what}, {t} thread{"s" if int(t) > 1 else ""}' for t in threads
                                  for what in ('forward', 'with backward')) + ' |')
    print('|---' * (1 + 2 * len(files)) + '|')
    for key, cells in shapes.items():
        texts = []
        for i in range(len(files)):
            for backward in (False, True):
                row = cells.get((i, backward))
                texts.append(f'{milliseconds(row)} ms, {share(row)}' if row else '-')
        print(f'| `{key}` | ' + ' | '.join(texts) + ' |')


def wholes(files):
    print('| row | ' + ' | '.join(f'{c["threads"]} thread{"s" if int(c["threads"]) > 1 else ""}' for c, _ in files) +
          ' | tensors MB | process MB |')
    print('|---' * (3 + len(files)) + '|')
    names = [n for n in files[-1][1] if re.match(r'splat|features|stage|cascade|train', n)]
    for name in names:
        texts = []
        for _, rows in files:
            row = rows.get(name)
            texts.append(f'{milliseconds(row)} ms, {share(row)}' if row else '-')
        last = files[-1][1][name]
        memory = [f'{last[k]:.0f}' if k in last else '' for k in ('peak_MB', 'process_MB')]
        print(f'| `{name}` | ' + ' | '.join(texts + memory) + ' |')


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith('-'):
        sys.exit(__doc__)
    files = [read(path) for path in sys.argv[1:]]
    operators(files)
    print()
    wholes(files)


if __name__ == '__main__':
    main()
