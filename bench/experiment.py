#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Trains the method, its ablations and other methods on the same simulated scenes for the same number of steps, scores
them on the same held-out scenes and writes the table.

  bench/experiment.py OUT [--steps 1000] [--seeds 1 2] [--only REGEX] [--lpips FILE] [--satsurf PROGRAM]
                      [--init FILE --preset NAME] [--study parts]

With --init all begin with one trained network, less what its modules have learned (fusion and guidance), so that each
variant makes its own from nothing: OUT/begin.safetensors. Of the variants those that are built like it are left: the
whole method and what lacks some of its modules.

--study parts asks what each part of wide8 brings that base8 does not have. The search for heights alone is trained,
nothing is rendered, and heights and surfaces alone are scored. --init then is a network built like base8, from which
all begin as it is: what wide8 adds begins at nothing.

Goes on where it stopped: whatever OUT already holds is not made again, and a stopped training goes on from its last
checkpoint. OUT/experiment.json is the configuration; another one needs another OUT. Beside each score
OUT/scores/NAME.csv, NAME.json says which program made it with which settings; a score or a network of other settings is
refused, a score that says nothing is taken as it is.

OUT/table.md and OUT/table.json hold all scores in OUT/scores, whatever was asked for this time: means over scenes and
seeds, ± half the range over the seeds (of two seeds, how far each lies from the mean), what the whole method gains over
each other variant, and what each of its three modules gains, averaged over all four settings of the other two: four
times the evidence, of the same trainings. A gain is `ahead` or `behind` where two things hold:
- its mean gain exceeds what separates the seeds, that is the range of their gains;
- a two-sided sign test over the scenes, of each scene's gain averaged over the seeds, gives p <= 0.05: of 12 scenes,
  10 of that sign. Ties are dropped.
Else it is `undecided`, and of a single seed `one seed`. Had nothing differed and did each scene of each seed vary by
itself, 2.5 % of the verdicts of two seeds and 12 scenes would be ahead or behind by chance (by the first condition
alone 29 %). A seed that moves all scenes alike makes the second condition worth less: 7 % if a tenth of the variance is
the seed's, 29 % if all of it is. So verdicts on many variants and columns hold some of chance.

Runs go side by side, a core each: that takes a fifth less time than one after the other, and any number of threads
gives the same bits. The monocular branch is that of --mono, for all that have one. LPIPS, named by its network, is
scored with the same network as the training loss has, so it favours what the loss asks for.
"""
import argparse
import concurrent.futures
import csv
import functools
import hashlib
import json
import math
import os
import re
import signal
import struct
import subprocess
import sys
import textwrap
import threading

# What differs from the whole method, by name. Every variant has the same steps, crops, learning rate and data. The
# losses are those of the preset: `paper` learns without true heights, the other methods have terms of their own.
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

# The preset of the whole method, in whose place --preset puts another.
METHOD = 'base8'

# Parameters of the modules, which --init leaves out. Routing has none.
OF_MODULES = re.compile(r'\.(fusion|guidance)\.')

# Of --study parts: what differs from wide8, all of them searching alone.
SEARCH = ['--preset', 'wide8', *(word for loss in ('geo', 'colour', 'ssim', 'render_height', 'lpips')
                                 for word in (f'--{loss}_weight', '0'))]
PARTS = {
    'full': SEARCH,
    'no best pair': [*SEARCH, '--model.best_pair', 'false'],
    'visible pairs instead': [*SEARCH, '--model.best_pair', 'false', '--model.visible_pairs', 'true'],
    'visible pairs too': [*SEARCH, '--model.visible_pairs', 'true'],
    'features of a quarter': [*SEARCH, '--model.feature_levels', '0'],
    'no local contrast': [*SEARCH, '--model.local_contrast', 'false'],
    'mean height': [*SEARCH, '--model.height', 'mean'],
    'bilinear centres': [*SEARCH, '--model.centre', 'bilinear'],
    'no distribution loss': [*SEARCH, '--distribution_weight', '0'],
    'heights out of reach': [*SEARCH, '--height_in_reach', 'false'],
    'views in their own light': [*SEARCH, '--radiometry_views', '0.1'],
    'none of the parts': ['--preset', 'base8', *SEARCH[2:]],
}

# What takes a module out.
SWITCHES = {'fusion': ('--model.fusion', 'none'), 'guidance': ('--model.guidance', 'none'),
            'routing': ('--routing', 'none')}

# Columns of the table: column of evaluate's CSV, title, factor, digits, whether less is better.
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

# Of --study parts: heights of the views, and the surface with its holes filled.
PARTS_COLUMNS = [
    ('mvs_source_mae', 'source MAE m', 1, 3, True),
    ('mvs_source_rmse', 'source RMSE m', 1, 3, True),
    ('mvs_source_pag1', 'source < 1 m %', 100, 1, False),
    ('mvs_source_pag2.5', 'source < 2.5 m %', 100, 1, False),
    ('dsm_filled_none_mae', 'filled DSM MAE m', 1, 3, True),
    ('dsm_filled_none_rmse', 'RMSE m', 1, 3, True),
    ('dsm_filled_none_pag1', '< 1 m %', 100, 1, False),
    ('dsm_filled_none_pag2.5', '< 2.5 m %', 100, 1, False),
    ('dsm_filled_none_pag7.5', '< 7.5 m %', 100, 1, False),
]

# Variants and columns by the question that is asked.
STUDIES = {'modules': (VARIANTS, COLUMNS), 'parts': (PARTS, PARTS_COLUMNS)}

# Seeds of the scenes. A configuration without them is of before they were recorded, and they were these.
DATA_SEEDS = {'train_seed': 101, 'heldout_seed': 202}

SIGNIFICANT = 0.05  # p of the sign test
NOTES = (
    '± half the range over the seeds. Error falls with confidence: in how many seeds each tenth of the pixels, by '
    'confidence, has a smaller mean error than the tenth before, for source views and for the DSM.',
    'Gains of the whole method over each other variant, seed by seed and mean over scenes, of errors the share that is '
    'saved; in brackets the scenes where it is better, averaged over the seeds. Those of a module are means over all '
    'settings of the other two. Ahead or behind: the mean gain exceeds what separates the seeds, and a sign test over '
    'the scenes gives p <= 0.05; had nothing differed and did each scene of each seed vary by itself, 2.5 % of the '
    'verdicts of two seeds and 12 scenes would be one of both by chance (up to 29 % where a seed moves all scenes '
    'alike).')

CORES = len(os.sched_getaffinity(0))
PRINTING = threading.Lock()


# --- files -----------------------------------------------------------------------------------------------------------
def write(path, content):
    """Writes a file of text or bytes, whole or not at all."""
    part = f'{path}.{os.getpid()}.part'
    with open(part, 'wb') as f:
        f.write(content if isinstance(content, bytes) else content.encode())
    os.replace(part, path)


def read_json(path):
    """The object in a JSON file."""
    with open(path, encoding='utf-8') as f:
        try:
            found = json.load(f)
        except ValueError as e:
            raise RuntimeError(f'{path}: not whole JSON ({e}); repair or remove it') from None
    if not isinstance(found, dict):
        raise RuntimeError(f'{path}: expected a JSON object')
    return found


def read_json_if_any(path):
    return read_json(path) if os.path.exists(path) else {}


def identity(path):
    """What a file is, wherever it lies; nothing for no file."""
    if not path:
        return ''
    with open(path, 'rb') as f:
        return f'{os.path.basename(path)} sha256:{hashlib.sha256(f.read()).hexdigest()[:16]}'


def file_name(variant):
    return re.sub(r'[^a-z0-9_]+', '-', variant)


def read_scores(path):
    """Mean row and {scene: row} of a table of evaluate; numbers that do not exist are left out."""
    with open(path, encoding='utf-8', newline='') as f:
        rows = list(csv.DictReader(f))
    try:
        named = [(row['scene'], {k: float(v) for k, v in row.items() if k != 'scene' and v}) for row in rows]
    except (KeyError, TypeError, ValueError) as e:
        raise RuntimeError(f'{path}: not a table of evaluate ({e!r})') from None
    if not named or named[-1][0] != 'mean':
        raise RuntimeError(f'{path}: no mean in the last row')
    *named, (_, mean) = named
    scenes = dict(named)
    if not scenes or len(scenes) < len(named):
        raise RuntimeError(f'{path}: {len(named)} rows of {len(scenes)} scenes, expected one of each')
    return mean, scenes


def read_header(f):
    """What a file of tensors, open for reading, says of them; its data follow."""
    size, = struct.unpack('<Q', f.read(8))
    return json.loads(f.read(size))


def read_training(weights):
    """What a network's file says of its training; nothing if there is no such file or it says nothing."""
    try:
        with open(weights, 'rb') as f:
            said = read_header(f)['__metadata__']
        return {'trained_by': f'satsurf {said["version"]} ({said["git"]})', 'seed': int(said['seed']),
                'step': int(said['step']), 'config': settings(json.loads(said['train']))}
    except (OSError, struct.error, ValueError, KeyError, TypeError):
        return {}


def settings(config):
    """A training's configuration without its files, whose contents experiment.json pins."""
    return {k: v for k, v in config.items() if k not in ('init', 'mono_weights', 'lpips_weights')}


def flat(value, name=''):
    """{'a': {'b': 1}} as {'a.b': 1}"""
    if not isinstance(value, dict):
        return {name: value}
    return {k: v for key, inner in value.items() for k, v in flat(inner, f'{name}.{key}' if name else key).items()}


def differences(before, wanted):
    """Of what both know, in words: a field that one lacks came or went with another version of the program."""
    before, wanted = flat(before), flat(wanted)
    text = [f'{k} is {before[k]!r}, wanted {wanted[k]!r}' for k in wanted if k in before and before[k] != wanted[k]]
    return '; '.join(text)


def without_modules(weights):
    """The bytes of a network's file without the modules' parameters, and without what else is no part of the cascade."""
    with open(weights, 'rb') as f:
        try:
            header, data = read_header(f), f.read()
            about = header.pop('__metadata__', {})
            kept = {k: v for k, v in header.items() if k.startswith('model.') and not OF_MODULES.search(k)}
            parts = [data[slice(*v['data_offsets'])] for v in kept.values()]
        except (struct.error, ValueError, KeyError, TypeError, AttributeError) as e:
            raise RuntimeError(f'{weights}: not a network ({e!r})') from None
    if not kept:
        raise RuntimeError(f'{weights}: no parameters of a cascade, expected a trained network')
    begin = 0
    for entry, part in zip(kept.values(), parts):
        entry['data_offsets'] = [begin, begin + len(part)]
        begin += len(part)
    text = json.dumps({'__metadata__': {k: about[k] for k in ('format', 'model') if k in about}} | kept).encode()
    text += b' ' * (-len(text) % 8)  # tensors begin at a whole word
    return struct.pack('<Q', len(text)) + text + b''.join(parts)


# --- verdicts --------------------------------------------------------------------------------------------------------
def sign_test(values):
    """How many are above and below zero, and how likely chance parts them at least as unevenly, either way."""
    ahead, behind = sum(v > 0 for v in values), sum(v < 0 for v in values)
    n = ahead + behind
    tail = sum(math.comb(n, k) for k in range(min(ahead, behind) + 1)) / 2**n
    return ahead, behind, min(1, 2 * tail)


def verdict(gains, scenes):
    """Whether gains, by seed, and gains, by scene and averaged over the seeds, say ahead or behind; see above."""
    if len(gains) == 1:
        return 'one seed'
    gain, spread = sum(gains) / len(gains), max(gains) - min(gains)
    ahead, behind, p = sign_test(scenes)
    if p <= SIGNIFICANT:
        if gain > spread and ahead > behind:
            return 'ahead'
        if gain < -spread and ahead < behind:
            return 'behind'
    return 'undecided'


def partners(module):
    """Variants that differ in one module alone: [(with it, without it)]."""
    named = {frozenset(zip(words[::2], words[1::2])): variant for variant, words in VARIANTS.items()}
    off = SWITCHES[module]
    return [(variant, named[words | {off}]) for words, variant in named.items()
            if off not in words and words | {off} in named]


def compare(pairs, column):
    """Variants against others in one column. By seed a list of pairs of {scene: row}, ours and the other; nothing if
    they have no numbers in common. Both of a pair saw the same crops and are scored on the same images, so what seeds
    and scenes do to either cancels: the gain is a mean of differences, of errors of their logarithms, as else the
    hardest scene would outweigh all others, told as the share of the other's error that is saved."""
    key, _, factor, _, less = column
    tables = [rows for of_seed in pairs for pair in of_seed for rows in pair]
    usable = [scene for scene in (tables[0] if tables else ())
              if all(key in rows[scene] and (not less or rows[scene][key] > 0) for rows in tables)]
    if not usable:
        return None

    def difference(ours, other):
        return math.log(other[key] / ours[key]) if less else ours[key] - other[key]
    by_seed = [[sum(difference(a[s], b[s]) for a, b in of_seed) / len(of_seed) for s in usable] for of_seed in pairs]
    gains = [sum(d) / len(d) for d in by_seed]
    gains = [100 * (1 - math.exp(-g)) for g in gains] if less else [factor * g for g in gains]
    scenes = [sum(d) / len(d) for d in zip(*by_seed)]
    ahead, behind, p = sign_test(scenes)
    return {'verdict': verdict(gains, scenes), 'gains': gains, 'unit': '%' if less else '', 'scenes': len(scenes),
            'ahead': ahead, 'behind': behind, 'p': p}


# --- the table -------------------------------------------------------------------------------------------------------
def cell(values, factor, digits):
    """Mean over the seeds, ± half their range."""
    if not values:
        return '-'
    mean = factor * sum(values) / len(values)
    if len(values) == 1:
        return f'{mean:.{digits}f}'
    half = factor * (max(values) - min(values)) / 2
    return f'{mean:.{digits}f} ± {half:.{digits}f}'


def confidence_cell(records):
    """In how many seeds the error falls with the confidence: of source views, of the DSM."""
    known = [r['error_falls_with_confidence'] for r in records if r.get('error_falls_with_confidence')]
    if not known:
        return '-'
    return ', '.join(f'{sum(k[of] for k in known)} of {len(known)}' for of in ('mvs_source', 'dsm'))


def study_of(config):
    """Variants and columns."""
    return STUDIES[config.get('study', 'modules')]


def columns_of(config, scores):
    """The study's columns, LPIPS with the name of its network: as evaluate says, else as its file is called."""
    said = [r['lpips_backbone'] for runs in scores.values() for *_, r in runs.values() if r.get('lpips_backbone')]
    file = config.get('lpips', '').split(' sha256:')[0]
    called = re.search('alex|squeeze|vgg', file)
    network = said[0] if said else called[0] if called else file
    return [(key, f'LPIPS ({network})' if title == 'LPIPS' and network else title, *rest)
            for key, title, *rest in study_of(config)[1]]


def gain_text(title, digits, found):
    if found['unit']:
        digits = 1
    each = ', '.join(f'{g:+.{digits}f}' for g in found['gains']) + (f' {found["unit"]}' if found['unit'] else '')
    return f'{title}: {each} ({found["ahead"]} of {found["scenes"]})'


def paragraph(text, indent=''):
    return textwrap.wrap(text, 120, initial_indent=indent, subsequent_indent=re.sub('[^ ]', ' ', indent),
                         break_long_words=False, break_on_hyphens=False)


def gains_of(scores, couples, columns):
    """What the first of each couple of variants gains over the second: the seeds that all have, and what `compare`
    finds, by column."""
    seeds = [k for k in scores[couples[0][0]] if all(k in scores[v] for couple in couples for v in couple)]
    pairs = [[(scores[a][k][1], scores[b][k][1]) for a, b in couples] for k in seeds]
    return seeds, [compare(pairs, column) for column in columns]


def gain_lines(gains, columns):
    """gains: {what: (seeds, [found by `compare`, by column])}"""
    lines = []
    for what, (seeds, found) in gains.items():
        which = f'seed{"s" if len(seeds) > 1 else ""} ' + ', '.join(map(str, seeds)) if seeds else 'no seed in common'
        lines.append(f'- {what}, {which}')
        for word in ('ahead', 'behind', 'undecided', 'one seed'):
            told = [gain_text(title, digits, f) for (_, title, _, digits, _), f in zip(columns, found)
                    if f and f['verdict'] == word]
            if told:
                lines += paragraph(f'{word}: ' + '; '.join(told), '  - ')
    return lines


def program_lines(scores):
    """By which programs the networks were trained."""
    by_program = {}
    for variant, runs in scores.items():
        for seed, (*_, record) in runs.items():
            by_program.setdefault(record.get('trained_by', 'not recorded'), []).append(f'{variant} {seed}')
    told = [f'{program} ({len(of)} score{"s" if len(of) > 1 else ""})' if len(of) > 4 or len(by_program) == 1 else
            f'{program} ({"; ".join(of)})' for program, of in by_program.items()]
    return paragraph('Trained by: ' + ', '.join(told) + '.')


def as_json(gains, columns):
    return {what: {'seeds': seeds, 'columns': {key: f for (key, *_), f in zip(columns, found) if f}}
            for what, (seeds, found) in gains.items()}


def write_table(out, config, scores):
    """Writes OUT/table.md and OUT/table.json and returns the lines of the first.
    scores: {variant: {seed: (mean row, {scene: row}, record)}}"""
    columns = columns_of(config, scores)
    titles = [title for _, title, *_ in columns] + ['error falls with confidence: sources, DSM']
    lines = ['| variant | ' + ' | '.join(titles) + ' |', '|---' * (len(titles) + 1) + '|']
    for variant, runs in scores.items():
        cells = [cell([mean[key] for mean, *_ in runs.values() if key in mean], factor, digits)
                 for key, _, factor, digits, _ in columns]
        cells.append(confidence_cell([record for *_, record in runs.values()]))
        lines.append(f'| {variant} | ' + ' | '.join(cells) + ' |')
    of_full = {v: gains_of(scores, [('full', v)], columns) for v in scores if v != 'full' and 'full' in scores}
    of_modules = {m: gains_of(scores, partners(m), columns) for m in SWITCHES
                  if all(v in scores for couple in partners(m) for v in couple)}
    gains = {f'full against {v}': found for v, found in of_full.items()}
    gains |= {f'{m} in all settings of the others': found for m, found in of_modules.items()}
    lines += ['', *paragraph(NOTES[0]), '', *program_lines(scores)]
    if gains:
        lines += ['', *paragraph(NOTES[1]), '', *gain_lines(gains, columns)]

    write(os.path.join(out, 'table.md'), '\n'.join(lines) + '\n')
    write(os.path.join(out, 'table.json'), json.dumps(
        {'experiment': config,
         'scores': {v: {k: {'mean': mean, 'scenes': scenes, 'record': record}
                        for k, (mean, scenes, record) in runs.items()} for v, runs in scores.items()},
         'gains_of_full': as_json(of_full, columns), 'gains_of_modules': as_json(of_modules, columns)},
        indent=2) + '\n')
    return lines


# --- running ---------------------------------------------------------------------------------------------------------
class Programs:
    """Runs programs until it is stopped."""

    def __init__(self):
        self.lock, self.stopped, self.running = threading.Lock(), False, set()

    def run(self, command, log):
        """Runs a program; what it says is added to a file."""
        with PRINTING:
            print('+', ' '.join(command), flush=True)
        with open(log, 'a', encoding='utf-8') as out:
            out.write('+ ' + ' '.join(command) + '\n')
            out.flush()
            with self.lock:  # none begins after `stop`
                if self.stopped:
                    raise RuntimeError('stopped')
                child = subprocess.Popen(command, stdout=out, stderr=out)
                self.running.add(child)
            code = child.wait()
            with self.lock:
                self.running.discard(child)
        if code != 0:
            raise RuntimeError(f'{command[0]} {command[1]} failed with {code}; see {log}')

    def stop(self):
        """Asks all to end: a training writes a checkpoint first. No other begins."""
        with self.lock:
            self.stopped = True
            for child in self.running:
                child.terminate()


def output_of(command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f'{" ".join(command)} failed with {done.returncode}: {done.stderr.strip()}')
    return done.stdout.strip()


@functools.cache
def printed_config(satsurf, *arguments):
    """A training's settings as this program understands its arguments, defaults and presets included."""
    command = [satsurf, 'train', '--print-config', *arguments]
    try:
        return settings(json.loads(output_of(command)))
    except ValueError as e:
        raise RuntimeError(f'{" ".join(command)}: not JSON ({e})') from None


class Experiment:
    """What is in a folder, and how to make what it lacks."""

    def __init__(self, arguments):
        self.asked, self.out, self.satsurf = arguments, arguments.out, arguments.satsurf
        self.config = {k: getattr(arguments, k) for k in ('steps', 'crop', 'scenes', 'heldout', 'pixels')}
        self.config |= {k: identity(getattr(arguments, k)) for k in ('mono', 'lpips')} | DATA_SEEDS
        if arguments.init:  # which has a monocular branch
            self.config |= {'mono': '', 'init': identity(arguments.init)}
        self.first = arguments.init  # that all begin with
        if arguments.study != 'modules':
            self.config['study'] = arguments.study
        elif arguments.init:
            self.config['preset'] = arguments.preset
            self.first = self.path('begin.safetensors')
        self.variants = study_of(self.config)[0]
        self.programs = Programs()
        self.threads = ['--threads', str(max(1, CORES // arguments.jobs))]
        self.made_by = {'program': output_of([self.satsurf, '--version']), 'binary': identity(self.satsurf)}

    def path(self, *names):
        return os.path.join(self.out, *names)

    def begin(self):
        """Makes the folder, or sees that it is of this experiment. What is recorded there stays as it is."""
        recorded = self.path('experiment.json')
        if os.path.exists(recorded):
            before = DATA_SEEDS | read_json(recorded)
            if before != self.config:
                told = differences(before, self.config) or f'it has {sorted(before)}, wanted {sorted(self.config)}'
                raise RuntimeError(f'{recorded} is of another experiment: {told}; give another OUT')
        for folder in ('scores', 'runs'):
            os.makedirs(self.path(folder), exist_ok=True)
        if self.first != self.asked.init and not os.path.exists(self.first):
            write(self.first, without_modules(self.asked.init))
        if not os.path.exists(recorded):
            write(recorded, json.dumps(self.config, indent=2) + '\n')

    def arguments_of(self, variant):
        """Of train, without files and folders."""
        words = [self.config.get('preset', word) if word == METHOD else word for word in self.variants[variant]]
        return [*words, '--steps', str(self.config['steps']), '--crop', str(self.config['crop'])]

    def settings_of(self, variant, seed):
        """What a training depends on, beside what experiment.json says."""
        arguments = self.arguments_of(variant)
        return {'arguments': ' '.join(arguments), 'steps': self.config['steps'], 'seed': seed,
                'config': printed_config(self.satsurf, *arguments)}

    def check(self, path, before, variant, seed):
        """That something was made as it would be made now. The program may be another one."""
        told = differences(before, self.settings_of(variant, seed)) if before else ''
        if told:
            raise RuntimeError(f'{path}: made with other settings: {told}; remove it to have it made again, or give '
                               'another OUT')

    def recorded(self):
        """What OUT/scores holds: [(variant, seed)] in the table's order, and the tables of no known variant."""
        variants = {file_name(v): v for v in self.variants}
        names = {f: re.fullmatch(r'(.+)-(\d+)\.csv', f) for f in sorted(os.listdir(self.path('scores')))}
        known = [(variants[m[1]], int(m[2])) for m in names.values() if m and m[1] in variants]
        others = [f for f, m in names.items() if f.endswith('.csv') and not (m and m[1] in variants)]
        return sorted(known, key=lambda run: (list(self.variants).index(run[0]), run[1])), others

    def collect(self):
        """All scores of known variants: {variant: {seed: (mean row, {scene: row}, record)}}."""
        scores, first = {}, None
        for variant, seed in self.recorded()[0]:
            name = f'{file_name(variant)}-{seed}'
            table, said = self.path('scores', name + '.csv'), self.path('scores', name + '.json')
            record = read_json_if_any(said)
            self.check(table, record, variant, seed)
            mean, scenes = read_scores(table)
            first = first or (table, set(scenes))
            if set(scenes) != first[1]:
                raise RuntimeError(f'{table} and {first[0]} are of different scenes: '
                                   f'{", ".join(sorted(set(scenes) ^ first[1]))} in one of them alone')
            record = self.findings(self.path('runs', name + '.evaluate.json')) | record
            scores.setdefault(variant, {})[seed] = mean, scenes, record
        return scores

    @staticmethod
    def findings(evaluated):
        """What evaluate says in JSON alone; nothing without a file."""
        results = read_json_if_any(evaluated).get('results', {})
        return {'lpips_backbone': results.get('lpips_backbone'),
                'error_falls_with_confidence': {k: of['monotone'] for k, of in results.get('confidence', {}).items()}}

    def simulate(self):
        for folder, scenes in (('train', 'scenes'), ('heldout', 'heldout')):
            if not os.path.exists(self.path(folder, 'run.json')):
                self.programs.run([self.satsurf, 'simulate', '--out', self.path(folder),
                                   '--scenes', str(self.config[scenes]), '--pixels', str(self.config['pixels']),
                                   '--seed', str(self.config[folder + '_seed']), '--overwrite'],
                                  self.path('simulate.log'))

    def train(self, variant, seed, log):
        """Trains what is not trained yet and returns what the network says of it."""
        folder = self.path('runs', f'{file_name(variant)}-{seed}')
        weights = os.path.join(folder, 'weights.safetensors')
        trained = read_training(weights)
        if trained.get('step', 0) < self.config['steps']:
            begun = os.path.exists(os.path.join(folder, 'checkpoint.safetensors'))  # train sees if it is of this run
            lpips = ['--lpips_weights', self.asked.lpips] if self.asked.lpips else []
            self.programs.run([self.satsurf, 'train', '--out', folder, *self.arguments_of(variant),
                               '--data', self.path('train'), '--seed', str(seed),
                               *(['--init', self.first] if self.first else ['--mono_weights', self.asked.mono]),
                               *lpips, *self.threads,
                               '--resume' if begun else '--overwrite'], log)
            trained = read_training(weights)
        self.check(folder, trained, variant, seed)
        return trained

    def score(self, variant, seed):
        """Trains, and scores on the held-out scenes."""
        name = f'{file_name(variant)}-{seed}'
        score, run, log = self.path('scores', name), self.path('runs', name), self.path('runs', name + '.log')
        trained = self.train(variant, seed, log)
        lpips = ['--lpips-weights', self.asked.lpips] if self.asked.lpips else []
        self.programs.run([self.satsurf, 'evaluate', '--data', self.path('heldout'),
                           '--weights', os.path.join(run, 'weights.safetensors'), '--csv', run + '.csv',
                           '--json', run + '.evaluate.json', '--overwrite', *self.threads, *lpips,
                           *(['--no-meshes'] if self.asked.study == 'parts' else [])], log)
        record = self.made_by | {'trained_by': trained.get('trained_by', 'not recorded')}
        record |= self.settings_of(variant, seed) | self.findings(run + '.evaluate.json')
        lines = [f'  {json.dumps(k)}: {json.dumps(v)}' for k, v in record.items()]
        write(score + '.json', '{\n' + ',\n'.join(lines) + '\n}\n')
        os.replace(run + '.csv', score + '.csv')  # last: no score without its record

    def write_table(self):
        scores = self.collect()
        seeds = sorted({seed for runs in scores.values() for seed in runs})
        return write_table(self.out, {**self.config, 'seeds': seeds}, scores)

    def run(self, variants, seeds):
        """Makes what is lacking, writes the table after each score and prints the last one."""
        self.begin()
        self.collect()  # refuses what is not of this experiment before hours of work
        there, others = self.recorded()
        if others:
            print('experiment.py: of no known variant and left out:', ', '.join(others), file=sys.stderr)
        # seed by seed: a table of one seed is there early
        lacking = [(v, seed) for seed in seeds for v in variants if (v, seed) not in there]
        if lacking:
            pool = concurrent.futures.ThreadPoolExecutor(self.asked.jobs)
            try:
                self.simulate()
                runs = {pool.submit(self.score, v, seed): f'{v}, seed {seed}' for v, seed in lacking}
                for count, finished in enumerate(concurrent.futures.as_completed(runs), 1):
                    finished.result()
                    self.write_table()
                    with PRINTING:
                        print(f'= {runs[finished]}: scored, {count} of {len(runs)}', flush=True)
            except BaseException:  # whatever stops one of them, or this program, stops all
                self.programs.stop()
                raise
            finally:
                pool.shutdown(cancel_futures=True)
        print('\n'.join(self.write_table()))


def positive(text):
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f'{value}, expected 1 or more')
    return value


def parse(words):
    root = os.path.join(os.path.dirname(os.path.abspath(__file__)), '..')
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('out', metavar='OUT', help='folder of everything')
    parser.add_argument('--satsurf', default=os.path.join(root, 'build/release/bin/satsurf'))
    parser.add_argument('--steps', type=positive, default=1000, help='of every variant')
    parser.add_argument('--crop', type=positive, default=96, help='side of the training windows, px')
    parser.add_argument('--scenes', type=positive, default=64, help='to train on')
    parser.add_argument('--heldout', type=positive, default=12, help='scenes to score on')
    parser.add_argument('--pixels', type=positive, default=384, help='rows and columns of the images')
    parser.add_argument('--mono', default=os.path.join(root, 'nn/weights/mono12.safetensors'),
                        help='weights of the monocular branch')
    parser.add_argument('--init', default='', help='trained network that all begin with; less its modules if '
                        'these are the study')
    parser.add_argument('--preset', default=METHOD, help='that a network for --init is built by')
    parser.add_argument('--study', default='modules', choices=STUDIES,
                        help='what is taken out: modules of the method, or parts of wide8')
    parser.add_argument('--seeds', type=int, nargs='+', default=[1, 2])
    parser.add_argument('--lpips', default='', help='LPIPS weights, for the loss and the score; neither without')
    parser.add_argument('--only', default='', help='variants whose name this regular expression finds')
    parser.add_argument('--jobs', type=positive, default=CORES, help='runs side by side')
    arguments = parser.parse_args(words)
    if not os.path.isfile(arguments.satsurf) or not os.access(arguments.satsurf, os.X_OK):
        raise RuntimeError(f'no program {arguments.satsurf}; build satsurf or name it with --satsurf')
    if arguments.preset != METHOD and not (arguments.init and arguments.study == 'modules'):
        raise RuntimeError('--preset: needs --init, and is not for --study parts')
    for flag, file in (('--mono', arguments.mono), ('--lpips', arguments.lpips), ('--init', arguments.init)):
        if not os.path.isfile(file) and not (flag != '--mono' and not file):
            raise RuntimeError(f'{flag}: no file {file!r}')
    try:
        known = STUDIES[arguments.study][0]
        variants = [v for v, words in known.items() if re.search(arguments.only, v) and
                    (arguments.study != 'modules' or not arguments.init or METHOD in words)]
    except re.error as e:
        raise RuntimeError(f'--only: {arguments.only!r} is no regular expression ({e})') from None
    if not variants:
        raise RuntimeError(f'--only: {arguments.only!r} finds none of the variants: {", ".join(known)}')
    return arguments, variants


def main():
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        arguments, variants = parse(None)
        Experiment(arguments).run(variants, list(dict.fromkeys(arguments.seeds)))
    except (RuntimeError, OSError) as e:
        sys.exit(f'experiment.py: {e}')
    except KeyboardInterrupt:
        print('experiment.py: stopped; the same command goes on from here', file=sys.stderr)
        sys.exit(130)


if __name__ == '__main__':
    main()
