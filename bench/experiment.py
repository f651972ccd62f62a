#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Trains the method, its ablations and other methods on the same simulated scenes for the same number of steps, scores
them on the same held-out scenes and writes the table.

  bench/experiment.py OUT [--steps 1200] [--seeds 1 2] [--only REGEX] [--lpips FILE] [--satsurf build/release/bin/satsurf]

Goes on where it stopped: whatever OUT already holds is not made again. OUT/experiment.json is the configuration; another
one needs another OUT. OUT/table.md and OUT/table.json hold the scores, means over the seeds with their spread.
"""
import argparse
import json
import os
import re
import subprocess
import sys

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
    ('render_target_ssim', 'SSIM', 1, 3, False),
    ('render_target_lpips', 'LPIPS', 1, 3, True),
    ('mvs_source_mae', 'source MAE m', 1, 3, True),
    ('dsm_mae', 'DSM MAE m', 1, 3, True),
    ('dsm_pag2.5', 'DSM < 2.5 m %', 100, 1, False),
    ('dsm_completeness', 'DSM complete %', 100, 1, False),
]


def run(command, log):
    print('+', ' '.join(command), flush=True)
    with open(log, 'a', encoding='utf-8') as out:
        out.write('+ ' + ' '.join(command) + '\n')
        out.flush()
        code = subprocess.run(command, stdout=out, stderr=out).returncode
    if code != 0:
        sys.exit(f'experiment.py: {command[0]} {command[1]} failed with {code}; see {log}')


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


def write_table(out, config, scores):
    """scores: {variant: [mean of evaluate, one per seed]}"""
    lines = ['| variant | ' + ' | '.join(title for _, title, *_ in COLUMNS) + ' |',
             '|---' * (len(COLUMNS) + 1) + '|']
    table = {}
    for variant, means in scores.items():
        cells, table[variant] = [], {}
        for key, _, factor, digits, _ in COLUMNS:
            values = [m[key] for m in means if m.get(key) is not None]
            table[variant][key] = values
            cells.append(cell(values, factor, digits))
        lines.append(f'| {variant} | ' + ' | '.join(cells) + ' |')
    full = table.get('full', {})
    lines.append('')
    for variant in table:
        if variant == 'full' or not full:
            continue
        verdicts = []
        for key, title, factor, digits, less in COLUMNS:
            a, b = full.get(key), table[variant][key]
            if not a or not b:
                continue
            gain = factor * (sum(b) / len(b) - sum(a) / len(a)) * (1 if less else -1)
            spread = factor * max(max(a) - min(a), max(b) - min(b))
            word = 'ahead' if gain > spread else 'behind' if gain < -spread else 'within the spread'
            verdicts.append(f'{title}: {word} ({gain:+.{digits}f}, spread {spread:.{digits}f})')
        lines.append(f'- full against {variant}: ' + '; '.join(verdicts))
    with open(os.path.join(out, 'table.md'), 'w', encoding='utf-8') as f:
        f.write('\n'.join(lines) + '\n')
    with open(os.path.join(out, 'table.json'), 'w', encoding='utf-8') as f:
        json.dump({'experiment': config, 'scores': table}, f, indent=2)
    print('\n'.join(lines))


def main():
    root = os.path.join(os.path.dirname(os.path.abspath(__file__)), '..')
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('out', metavar='OUT', help='folder of everything')
    parser.add_argument('--satsurf', default=os.path.join(root, 'build/release/bin/satsurf'))
    parser.add_argument('--steps', type=int, default=1200, help='of every variant')
    parser.add_argument('--crop', type=int, default=128, help='side of the training windows, px')
    parser.add_argument('--mono-steps', type=int, default=2000, help='of the monocular branch, trained once')
    parser.add_argument('--scenes', type=int, default=48, help='to train on')
    parser.add_argument('--heldout', type=int, default=12, help='scenes to score on')
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2])
    parser.add_argument('--lpips', default='', help='LPIPS weights, for the loss and the score; neither without')
    parser.add_argument('--only', default='', help='variants whose name this regular expression finds')
    arguments = parser.parse_args()
    if not os.access(arguments.satsurf, os.X_OK):
        sys.exit(f'experiment.py: no program {arguments.satsurf}; build satsurf or name it with --satsurf')

    out = arguments.out
    os.makedirs(os.path.join(out, 'scores'), exist_ok=True)
    config = {k: getattr(arguments, k) for k in ('steps', 'crop', 'mono_steps', 'scenes', 'heldout', 'lpips')}
    recorded = os.path.join(out, 'experiment.json')
    if os.path.exists(recorded):
        with open(recorded, encoding='utf-8') as f:
            before = json.load(f)
        if before != config:
            sys.exit(f'experiment.py: {recorded} is of another experiment: {before}, wanted {config}; '
                     'give another OUT')
    with open(recorded, 'w', encoding='utf-8') as f:
        json.dump(config, f, indent=2)

    satsurf, log = arguments.satsurf, os.path.join(out, 'log.txt')
    for name, scenes, seed in (('train', arguments.scenes, 101), ('heldout', arguments.heldout, 202)):
        if not os.path.exists(os.path.join(out, name, 'run.json')):
            run([satsurf, 'simulate', '--out', os.path.join(out, name), '--scenes', str(scenes), '--seed', str(seed),
                 '--overwrite'], log)
    data, mono = os.path.join(out, 'train'), os.path.join(out, 'mono')
    train(satsurf, mono, arguments.mono_steps, ['--task', 'mono', '--data', data, '--seed', '1'], log)

    lpips = ['--lpips_weights', arguments.lpips] if arguments.lpips else []
    scores = {}
    for seed in arguments.seeds:  # seed by seed: a table of one seed is there early
        for variant, flags in VARIANTS.items():
            if not re.search(arguments.only, variant):
                continue
            name = f'{file_name(variant)}-{seed}'
            run_folder, score = os.path.join(out, 'runs', name), os.path.join(out, 'scores', name + '.json')
            train(satsurf, run_folder, arguments.steps,
                  [*flags, '--data', data, '--seed', str(seed), '--crop', str(arguments.crop), '--mono_weights',
                   os.path.join(mono, 'weights.safetensors'), *lpips], log)
            if not os.path.exists(score):
                run([satsurf, 'evaluate', '--data', os.path.join(out, 'heldout'), '--weights',
                     os.path.join(run_folder, 'weights.safetensors'), '--json', score,
                     *(['--lpips-weights', arguments.lpips] if arguments.lpips else [])], log)
            with open(score, encoding='utf-8') as f:
                scores.setdefault(variant, []).append(json.load(f)['results']['mean'])
            write_table(out, {**config, 'seeds': arguments.seeds}, scores)


if __name__ == '__main__':
    main()
