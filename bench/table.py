#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Prints the JSON files of satsurf-bench as the Markdown tables of results.md.

  bench/table.py ONE_THREAD.json TWO_THREADS.json

First the machine's limits, then a table of operators and one of every other row of any file: the splatter, the
network's parts, whole passes and training steps. Left out are `peak_fma` and `triad` alone, which measure the limits
again.
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


def cell(row):
    if not row:
        return '-'
    if row.get('error_occurred'):
        return f'failed: {row.get("error_message", "")}'
    return f'{row["real_time"]:.3g} ms, {share(row)}'


def operator(name):
    """(row, whether with backward) of an operator; nothing for others: the splatter times its two passes apart."""
    match = re.match(r'(\w+?)_fwd(_bwd)?(/.*|)$', name)
    return (match[1] + match[3], bool(match[2])) if match and not name.startswith('splat') else None


def threads(context):
    count = context['threads']
    return f'{count} thread{"s" if int(count) > 1 else ""}'


def limits(files):
    for c, _ in files:
        print(f'{threads(c)}: FMA peak {c["peak_fma_gflops"]} GFLOP/s, triad {c["triad_gb_per_s"]} GB/s')


def operators(files):
    shapes = {}
    for i, (_, rows) in enumerate(files):
        for name, row in rows.items():
            if operator(name):
                key, backward = operator(name)
                shapes.setdefault(key, {})[(i, backward)] = row
    print('| row | ' + ' | '.join(f'{what}, {threads(c)}' for c, _ in files
                                  for what in ('forward', 'with backward')) + ' |')
    print('|---' * (1 + 2 * len(files)) + '|')
    for key, cells in shapes.items():
        texts = [cell(cells.get((i, backward))) for i in range(len(files)) for backward in (False, True)]
        print(f'| `{key}` | ' + ' | '.join(texts) + ' |')


def wholes(files):
    print('| row | ' + ' | '.join(threads(c) for c, _ in files) + ' | tensors MB | process MB |')
    print('|---' * (3 + len(files)) + '|')
    names = dict.fromkeys(n for _, rows in reversed(files) for n in rows
                          if not operator(n) and n not in ('peak_fma', 'triad'))
    for name in names:
        texts = [cell(rows.get(name)) for _, rows in files]
        last = [rows[name] for _, rows in files if name in rows][-1]
        memory = [f'{last[k]:.0f}' if k in last else '' for k in ('peak_MB', 'process_MB')]
        print(f'| `{name}` | ' + ' | '.join(texts + memory) + ' |')


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith('-'):
        sys.exit(__doc__)
    files = [read(path) for path in sys.argv[1:]]
    limits(files)
    print()
    operators(files)
    print()
    wholes(files)


if __name__ == '__main__':
    main()
