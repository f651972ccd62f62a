#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Runs satsurf-bench and PyTorch alternately on the same work and prints how many times faster ours is.

  bench/peers.py FOLDER [--bench build/release/bin/satsurf-bench] [--only REGEX] [--rounds 3] [--threads N]

FOLDER has torch_ops.py and torch_cascade.py, which need Debian's python3-torch and libopenblas0. A peer's
time is that of its fastest variant; a time is the median over the rounds. Memory is the peak of the process.
"""
import argparse
import ctypes.util
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile

PYTHON = '/usr/bin/python3'  # where Debian's torch is, whatever else is on the path

# Ours: op and shape. Theirs: terms to add up, with the word that switches on their part of torch_ops.py.
CONV3D, CONV2D, UP = 'B:{}/C:{}/O:{}/D:{}/side:{}/s:{}', 'B:{}/C:{}/O:{}/side:{}/k:{}/s:{}', 'B:{}/C:{}/O:{}/D:{}/side:{}'
OPS = [
    ('conv3d', CONV3D.format(1, c, o, d, n, 1), [f'conv3d [1,{c},{d},{n},{n}]>{o}'], '')
    for c, o, d, n in ((8, 8, 48, 64), (32, 8, 48, 64), (16, 8, 32, 128), (8, 8, 8, 256), (16, 16, 24, 32), (32, 32, 12, 16), (64, 64, 6, 8))
] + [
    ('conv3d', CONV3D.format(1, 8, 16, d, n, 2), [f'conv3ds2 [1,8,{d},{n},{n}]>16'], '') for d, n in ((48, 64), (32, 128))
] + [
    ('conv_transpose3d', UP.format(1, 16, 8, d, n), [f'deconv3d [1,16,{d},{n},{n}]>8'], '') for d, n in ((24, 32), (16, 64))
] + [
    ('conv2d', CONV2D.format(3, c, c, n, 3, 1), [f'conv2d3 [3,{c},{n},{n}]>{c}'], '') for c, n in ((8, 1024), (16, 512), (32, 256))
] + [
    ('conv2d', CONV2D.format(3, 64, 64, 128, 1, 1), ['conv2d1 [3,64,128,128]>64'], ''),
    ('group_norm_relu', 'C:32/D:3/side:256', ['groupnorm8+relu [3,32,256,256]'], 'norm'),
    ('relu', 'C:32/side:256', ['relu [3,32,256,256]'], ''),
    ('add', 'C:32/side:256', ['add [3,32,256,256]'], ''),
    ('softmax_expectation_max', 'B:1/D:48/side:256', ['softmax+expectation D48'], ''),
    ('resize_bilinear_x2', 'B:1/C:32/side:256', ['upsample2x bilinear [1,32,256,256]'], ''),
    ('resize_nearest_x2', 'B:1/C:32/side:256', ['upsample2x nearest [1,32,256,256]'], ''),
    ('plane_sweep_variance', 'C:32/D:48/side:64', 2 * ['gridsample 32x64^2 x48 dX'] + ['variance3 [1,32,48,64,64]'], 'gridsample|variance'),
    ('matmul', 'M:1370/K:384/N:1152', ['linear 384>1152 [1370]'], 'vit|layernorm|mha|gelu|linear'),
]
# Ours, what torch_cascade.py is told, its variants. The largest takes 10 GB and 40 s a pass there: once.
CASCADES = [
    ('cascade_infer/views:3/side:256', ['--size', '256'], [[], ['--freeze'], ['--freeze', '--channels-last']]),
    ('cascade_infer/views:3/side:512', ['--size', '512', '--runs', '3'], [['--freeze']]),
    ('cascade_infer/views:3/side:1024', ['--size', '1024', '--runs', '1'], [[]]),
    ('train_step/views:3/side:256', ['--size', '256', '--mode', 'train', '--runs', '3'], [[], ['--channels-last']]),
]


def fail(text):
    sys.exit(f'peers.py: {text}')


def output_of(command, **more):
    done = subprocess.run(command, capture_output=True, text=True, **more)
    if done.returncode != 0:
        fail(f'{" ".join(command)} failed with {done.returncode}:\n{done.stderr.strip()}')
    return done.stdout


class Ours:
    def __init__(self, program, threads):
        self.program, self.environment = program, {**os.environ, 'SATSURF_THREADS': str(threads)}
        self.shares = {}

    def __call__(self, rows):
        """{row: milliseconds}, {row: megabytes}"""
        names = '|'.join(re.escape(row) for row in rows)
        text = output_of([self.program, f'--benchmark_filter=^({names})$', '--benchmark_format=json',
                          '--benchmark_min_time=0.3'], env=self.environment)
        found = {b['name']: b for b in json.loads(text)['benchmarks']}
        for row in rows:
            if row not in found:
                fail(f'{self.program} has no row {row}')
            self.shares.setdefault(row, []).append(found[row]['share'])
        return {row: found[row]['real_time'] for row in rows}, {row: found[row].get('process_MB') for row in rows}


def torch_op_times(folder, threads, terms, switch):
    """Milliseconds of the fastest variant, summed over the terms, by mode."""
    names = sorted(set(terms))
    switches = [switch] if switch.startswith('vit') else [s for s in switch.split('|') if s]
    pattern = '^(' + '|'.join(re.escape(n) for n in names + switches) + ')$'
    with tempfile.NamedTemporaryFile(suffix='.json') as out:
        output_of([PYTHON, os.path.join(folder, 'torch_ops.py'), '--threads', str(threads), '--only', pattern,
                   '--budget', '0.3', '--out', out.name])
        records = json.load(open(out.name))
    times = {}
    for mode, suffix in (('fwd', '_fwd'), ('fwd+bwd', '_fwd_bwd')):
        best = {n: min((r['ms'] for r in records if r['op'] == n and r['mode'] == mode), default=None) for n in names}
        if all(best.values()):
            times[suffix] = sum(best[n] for n in terms)
    if not times:
        fail(f'torch_ops.py knows no {names}')
    return times


def print_row(name, ours, theirs, ours_mb=None, theirs_mb=None, share=None):
    cells = [f'{name:62}', f'{ours:10.2f}', f'{theirs:10.2f}', f'{theirs / ours:7.2f} x',
             f'{100 * share:6.1f} %' if share else ' ' * 8]
    if ours_mb:
        cells += [f'{ours_mb:8.0f}', f'{theirs_mb:8.0f}', f'{theirs_mb / ours_mb:6.1f} x']
    print(' '.join(cells), flush=True)


def compare_op(ours, arguments, op, shape, terms, switch):
    times = {}
    for _ in range(arguments.rounds):
        for suffix, ms in torch_op_times(arguments.folder, arguments.threads, terms, switch).items():
            times.setdefault(suffix, ([], []))[1].append(ms)
        own, _ = ours([f'{op}{suffix}/{shape}' for suffix in times])
        for suffix in times:
            times[suffix][0].append(own[f'{op}{suffix}/{shape}'])
    for suffix, (own, theirs) in times.items():
        row = f'{op}{suffix}/{shape}'
        print_row(row, statistics.median(own), statistics.median(theirs), share=statistics.median(ours.shares[row]))


def compare_cascade(ours, arguments, row, flags, variants):
    own, theirs, own_mb, theirs_mb = [], {}, [], {}
    for _ in range(1 if '1024' in flags else arguments.rounds):
        for variant in variants:
            record = json.loads(output_of([PYTHON, os.path.join(arguments.folder, 'torch_cascade.py'), '--threads',
                                           str(arguments.threads), *flags, *variant]))
            theirs.setdefault(tuple(variant), []).append(record['ms'])
            theirs_mb[tuple(variant)] = record['peak_mb'] * 1024 * 1024 / 1e6
        time, memory = ours([row])
        own.append(time[row])
        own_mb.append(memory[row])
    best = min(theirs, key=lambda v: statistics.median(theirs[v]))
    print_row(f'{row} ({" ".join(best) or "eager"})', statistics.median(own), statistics.median(theirs[best]),
              max(own_mb), theirs_mb[best], statistics.median(ours.shares[row]))


def main():
    root = os.path.join(os.path.dirname(os.path.abspath(__file__)), '..')
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('folder', help='where torch_ops.py and torch_cascade.py are')
    parser.add_argument('--bench', default=os.path.join(root, 'build/release/bin/satsurf-bench'))
    parser.add_argument('--only', default='', help='rows whose name this regular expression finds')
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--threads', type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    for script in ('torch_ops.py', 'torch_cascade.py'):
        if not os.path.isfile(os.path.join(arguments.folder, script)):
            fail(f'{arguments.folder} has no {script}')
    if not os.access(arguments.bench, os.X_OK):
        fail(f'no program {arguments.bench}; build satsurf-bench or name it with --bench')
    if subprocess.run([PYTHON, '-c', 'import torch'], capture_output=True).returncode != 0:
        fail(f'{PYTHON} cannot import torch; as root: apt-get install python3-torch libopenblas0')
    if ctypes.util.find_library('openblas') is None:
        fail('libopenblas is missing, without which the peer is up to 40 times slower; as root: apt-get install libopenblas0')

    ours = Ours(arguments.bench, arguments.threads)
    print(f'{"row":62} {"ours ms":>10} {"torch ms":>10} {"faster":>9} {"share":>8} {"ours MB":>8} {"torch MB":>8} {"less":>8}')
    for op, shape, terms, switch in OPS:
        if re.search(arguments.only, f'{op}_fwd/{shape}') or re.search(arguments.only, f'{op}_fwd_bwd/{shape}'):
            compare_op(ours, arguments, op, shape, terms, switch)
    for row, flags, variants in CASCADES:
        if re.search(arguments.only, row):
            compare_cascade(ours, arguments, row, flags, variants)


if __name__ == '__main__':
    main()
