#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tests bench/experiment.py with a program in satsurf's place that trains nothing.

  tests/test_experiment.py
"""
import importlib.util
import json
import math
import os
import random
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
import unittest

sys.dont_write_bytecode = True  # nothing is left in bench
SCRIPT = os.path.join(os.path.dirname(os.path.abspath(__file__)), '../bench/experiment.py')
spec = importlib.util.spec_from_file_location('experiment', SCRIPT)
experiment = importlib.util.module_from_spec(spec)
spec.loader.exec_module(experiment)

ERROR = ('mae', 'MAE m', 1, 3, True)
SCORE = ('psnr', 'PSNR dB', 1, 2, False)
SCENES = [f'SIM_{i:03}' for i in range(1, 13)]

# Says what it is told to do in the file `calls` beside it. With a file `wait` there, train waits to be stopped; with
# `fail`, it fails; `config` is added to the configuration it prints.
SATSURF = '''#!{python}
import json, os, signal, struct, sys, time
here, words = os.path.dirname(os.path.abspath(__file__)), sys.argv[1:]
told = lambda flag: words[words.index(flag) + 1]
has = lambda name: os.path.exists(os.path.join(here, name))
def say(text):
    with open(os.path.join(here, 'calls'), 'a') as f:
        f.write(text + '\\n')
def put(path, data):
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, 'wb') as f:
        f.write(data if isinstance(data, bytes) else data.encode())
if words == ['--version']:
    print('satsurf 9.8.7 (abc)')
    sys.exit()
config = {{'preset': told('--preset'), 'steps': int(told('--steps')), 'model': {{'fusion': 'cmmf', 'width': 0.1}},
          'mono_weights': 'here', 'lpips_weights': 'there', 'init': ''}} if words[0] == 'train' else {{}}
if '--model.fusion' in words:
    config['model']['fusion'] = told('--model.fusion')
if has('config'):
    config |= json.load(open(os.path.join(here, 'config')))
if '--print-config' in words:
    print(json.dumps(config))
    sys.exit()
say(' '.join(words))
if words[0] == 'simulate':
    put(told('--out') + '/run.json', '{{}}')
elif words[0] == 'train':
    if has('fail'):
        sys.exit(3)
    if has('wait'):
        def stopped(number, frame):
            say('stopped')
            sys.exit(128 + number)
        signal.signal(signal.SIGTERM, stopped)
        say('waits')
        time.sleep(60)
    header = json.dumps({{'__metadata__': {{'train': json.dumps(config), 'seed': told('--seed'), 'step': told('--steps'),
                                          'version': '9.8.6', 'git': 'abb'}}}}).encode()
    put(told('--out') + '/weights.safetensors', struct.pack('<Q', len(header)) + header)
elif words[0] == 'evaluate':
    value = 1 if '/full-' in told('--csv') else 1.5
    put(told('--csv'), 'scene,dsm_mae,render_target_lpips\\n' +
        ''.join(f'{{s}},{{value}},0.2\\n' for s in ['A', 'B', 'mean']))
    put(told('--json'), json.dumps({{'results': {{'lpips_backbone': 'alex', 'confidence': {{
        'mvs_source': {{'monotone': True}}, 'dsm': {{'monotone': False}}}}}}}}))
'''


def rows(key, values, names=None):
    return {s: {key: v} for s, v in zip(names or SCENES, values)}


def compare(full, other, column):
    """One variant against another: [{scene: row}] of the same seeds."""
    return experiment.compare([[pair] for pair in zip(full, other)], column)


def table(scenes, value):
    """A table of evaluate."""
    return 'scene,dsm_mae\n' + ''.join(f'{s},{value}\n' for s in [*scenes, 'mean'])


class Verdict(unittest.TestCase):
    def test_sign_test(self):
        self.assertEqual(experiment.sign_test([]), (0, 0, 1))
        self.assertEqual(experiment.sign_test([1, -1, 0]), (1, 1, 1))
        self.assertEqual(experiment.sign_test([1] * 12), (12, 0, 2 / 4096))
        self.assertEqual(experiment.sign_test([1] * 10 + [-1] * 2), (10, 2, 2 * 79 / 4096))
        self.assertEqual(experiment.sign_test([-1] * 6 + [0] * 6), (0, 6, 2 / 64))

    def test_both_conditions(self):
        ten, nine = [1] * 10 + [-1] * 2, [1] * 9 + [-1] * 3
        self.assertEqual(experiment.verdict([2, 3], ten), 'ahead')
        self.assertEqual(experiment.verdict([-2, -3], [-s for s in ten]), 'behind')
        self.assertEqual(experiment.verdict([2, 3], nine), 'undecided')  # p 0.15
        self.assertEqual(experiment.verdict([1, 3.1], ten), 'undecided')  # 2.05 against 2.1
        self.assertEqual(experiment.verdict([2, 3], nine + [1] * 9), 'ahead')
        self.assertEqual(experiment.verdict([2, 3], [-s for s in ten]), 'undecided')  # the mean is of two scenes
        self.assertEqual(experiment.verdict([3], ten), 'one seed')

    def chance(self, rounds, scene):
        """Share of verdicts that are ahead or behind; scene() gives two seeds of 12 gains where nothing differs."""
        found = 0
        for _ in range(rounds):
            seeds = scene()
            found += experiment.verdict([sum(s) / 12 for s in seeds],
                                        [sum(s) / 2 for s in zip(*seeds)]) in ('ahead', 'behind')
        return 100 * found / rounds

    def test_chance_is_as_told(self):
        rng = random.Random(1)
        told = [float(v) for v in re.findall(r'([\d.]+) %', experiment.NOTES[1])]
        self.assertEqual(told, [2.5, 29])
        alone = self.chance(12000, lambda: [[rng.gauss(0, 1) for _ in range(12)] for _ in range(2)])
        self.assertAlmostEqual(alone, told[0], delta=0.5)  # more than three deviations
        alike = self.chance(6000, lambda: [[rng.gauss(0, 1)] * 12 for _ in range(2)])
        self.assertAlmostEqual(alike, told[1], delta=2)
        tenth = self.chance(6000, lambda: [[shift + rng.gauss(0, 0.9**0.5) for _ in range(12)]
                                           for shift in (rng.gauss(0, 0.1**0.5), rng.gauss(0, 0.1**0.5))])
        self.assertAlmostEqual(tenth, 7.3, delta=1.2)


class Compare(unittest.TestCase):
    def test_errors_by_their_ratio(self):
        full, other = [rows('mae', [1.] * 12), rows('mae', [2.] * 12)], [rows('mae', [2.] * 12), rows('mae', [4.] * 12)]
        found = compare(full, other, ERROR)
        self.assertEqual(found['verdict'], 'ahead')
        for gain in found['gains']:
            self.assertAlmostEqual(gain, 50)
        self.assertEqual((found['unit'], found['ahead'], found['behind'], found['scenes']), ('%', 12, 0, 12))
        self.assertEqual(compare(other, full, ERROR)['verdict'], 'behind')
        self.assertEqual(experiment.gain_text('MAE m', 3, found), 'MAE m: +50.0, +50.0 % (12 of 12)')

    def test_others_by_their_difference(self):
        found = compare([rows('psnr', [20.5] * 12)], [rows('psnr', [20.] * 12)], SCORE)
        self.assertEqual((found['verdict'], found['gains'], found['unit']), ('one seed', [0.5], ''))
        self.assertEqual(experiment.gain_text('PSNR dB', 2, found), 'PSNR dB: +0.50 (12 of 12)')

    def test_joined_by_name(self):
        values = [float(i) for i in range(1, 13)]
        full = rows('psnr', values)
        other = rows('psnr', [v - 1 for v in reversed(values)], list(reversed(SCENES)))
        self.assertEqual(compare([full], [other], SCORE)['ahead'], 12)

    def test_scenes_count_averaged_over_seeds(self):
        full = [rows('psnr', [1.] * 12), rows('psnr', [-3.] + [1.] * 11)]
        found = compare(full, [rows('psnr', [0.] * 12)] * 2, SCORE)
        self.assertEqual((found['ahead'], found['behind'], found['scenes']), (11, 1, 12))

    def test_what_does_not_exist(self):
        full, other = rows('mae', [1.] * 12), rows('mae', [2.] * 12)
        del full['SIM_003']['mae']
        other['SIM_004']['mae'] = 0.  # no logarithm
        self.assertEqual(compare([full], [other], ERROR)['scenes'], 10)
        self.assertIsNone(compare([full], [other], SCORE))
        self.assertIsNone(compare([], [], SCORE))


class Modules(unittest.TestCase):
    OFF = {'full': '', 'no fusion': 'F', 'no guidance': 'G', 'no routing': 'R', 'no fusion, no guidance': 'FG',
           'no fusion, no routing': 'FR', 'no guidance, no routing': 'GR', 'none of the three': 'FGR'}

    def test_partners(self):
        for module, letter in (('fusion', 'F'), ('guidance', 'G'), ('routing', 'R')):
            couples = experiment.partners(module)
            self.assertEqual({(self.OFF[a], self.OFF[b].replace(letter, '')) for a, b in couples},
                             {(off, off) for off in self.OFF.values() if letter not in off})
            self.assertTrue(all(letter in self.OFF[b] for _, b in couples))

    def scores(self, seeds, value):
        """value(which are off, seed)"""
        return {v: {seed: ({}, rows('psnr', [value(off, seed)] * 12), {}) for seed in seeds}
                for v, off in self.OFF.items()}

    def test_means_over_settings(self):
        def value(off, seed):  # fusion: 2; routing: 1 with guidance, -1 without
            return seed - 2 * ('F' in off) - (('R' in off) != ('G' in off))
        scores = self.scores([1, 2], value)
        found = {m: experiment.gains_of(scores, experiment.partners(m), [SCORE]) for m in experiment.SWITCHES}
        self.assertEqual([(seeds, of[0]['gains']) for seeds, of in found.values()],
                         [([1, 2], [2, 2]), ([1, 2], [0, 0]), ([1, 2], [0, 0])])
        self.assertEqual(found['fusion'][1][0]['verdict'], 'ahead')
        self.assertEqual(found['routing'][1][0]['verdict'], 'undecided')
        self.assertEqual(experiment.gains_of(scores, [('full', 'no routing')], [SCORE])[1][0]['gains'], [1, 1])

    def test_seeds_that_all_have(self):
        scores = self.scores([1, 2, 3], lambda off, seed: 1.)
        del scores['none of the three'][2]
        self.assertEqual(experiment.gains_of(scores, experiment.partners('routing'), [SCORE])[0], [1, 3])
        self.assertEqual(experiment.gains_of(scores, [('full', 'no routing')], [SCORE])[0], [1, 2, 3])
        for seed in (1, 3):
            del scores['no routing'][seed]
        self.assertEqual(experiment.gains_of(scores, experiment.partners('routing'), [SCORE]), ([], [None]))


class Cells(unittest.TestCase):
    def test_cell(self):
        self.assertEqual(experiment.cell([], 1, 2), '-')
        self.assertEqual(experiment.cell([0.5], 100, 1), '50.0')
        self.assertEqual(experiment.cell([1., 2.], 1, 2), '1.50 ± 0.50')
        self.assertEqual(experiment.cell([1., 2., 6.], 1, 1), '3.0 ± 2.5')

    def test_confidence(self):
        yes, no = ({'error_falls_with_confidence': {'mvs_source': True, 'dsm': b}} for b in (True, False))
        self.assertEqual(experiment.confidence_cell([yes, no]), '2 of 2, 1 of 2')
        self.assertEqual(experiment.confidence_cell([no, {}]), '1 of 1, 0 of 1')
        self.assertEqual(experiment.confidence_cell([{}]), '-')

    def test_lpips_is_named(self):
        def title(lpips, record):
            return dict(c[:2] for c in experiment.columns_of({'lpips': lpips}, {'full': {1: ({}, {}, record)}}))[
                'render_target_lpips']
        self.assertEqual(title('', {}), 'LPIPS')
        self.assertEqual(title('lpips_alex.safetensors sha256:0', {}), 'LPIPS (alex)')
        self.assertEqual(title('weights.safetensors sha256:0', {}), 'LPIPS (weights.safetensors)')
        self.assertEqual(title('weights.safetensors sha256:0', {'lpips_backbone': 'vgg'}), 'LPIPS (vgg)')

    def test_differences(self):
        self.assertEqual(experiment.differences({'a': {'b': 1}, 'old': 1}, {'a': {'b': 1.}, 'new': 2}), '')
        self.assertEqual(experiment.differences({'a': {'b': 1}}, {'a': {'b': 2}}), 'a.b is 1, wanted 2')


class Folder(unittest.TestCase):
    """Tests in a folder of their own."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.here = folder.name

    def put(self, name, text):
        path = os.path.join(self.here, name)
        os.makedirs(os.path.dirname(path), exist_ok=True)
        with open(path, 'wb') as f:
            f.write(text if isinstance(text, bytes) else text.encode())
        return path


class Files(Folder):
    def test_read_scores(self):
        mean, scenes = experiment.read_scores(self.put('a.csv', 'scene,x,y\nA,1,2\nB,3,\nmean,2,2\n'))
        self.assertEqual(mean, {'x': 2, 'y': 2})
        self.assertEqual(scenes, {'A': {'x': 1, 'y': 2}, 'B': {'x': 3}})

    def test_read_scores_refuses(self):
        for text, message in (('', 'no mean'), ('scene,x\nA,1\n', 'no mean'), ('a,b\n1,2\n', 'not a table'),
                              ('scene,x\nA,one\nmean,1\n', 'not a table'), ('scene,x\nA,1,2\nmean,1\n', 'not a table'),
                              ('scene,x\nmean,1\n', '0 scenes'), ('scene,x\nA,1\nA,1\nmean,1\n', '2 rows of 1 scenes')):
            with self.subTest(text), self.assertRaisesRegex(RuntimeError, message):
                experiment.read_scores(self.put('a.csv', text))

    def test_read_training(self):
        self.assertEqual(experiment.read_training(os.path.join(self.here, 'none')), {})
        for damaged in (b'', b'abc', struct.pack('<Q', 5) + b'{}', struct.pack('<Q', 2) + b'{}'):
            self.assertEqual(experiment.read_training(self.put('w', damaged)), {})

    def test_write_leaves_nothing_else(self):
        experiment.write(os.path.join(self.here, 'a'), 'one')
        experiment.write(os.path.join(self.here, 'a'), 'two')
        self.assertEqual(os.listdir(self.here), ['a'])


class Script(Folder):
    """The whole script, as a program."""

    def setUp(self):
        super().setUp()
        self.satsurf = self.put('bin/satsurf', SATSURF.format(python=sys.executable))
        os.chmod(self.satsurf, 0o755)
        self.mono, self.lpips = self.put('mono12', 'mono'), self.put('lpips_alex', 'lpips')
        self.out = os.path.join(self.here, 'out')

    def command(self, *words):
        return [sys.executable, SCRIPT, self.out, '--satsurf', self.satsurf, '--mono', self.mono, '--lpips', self.lpips,
                '--steps', '5', '--jobs', '1', '--only', '^(full|no fusion)$', *words]

    def runs(self, *words):
        done = subprocess.run(self.command(*words), capture_output=True, text=True, timeout=60)
        self.assertEqual((done.returncode, done.stderr), (0, ''))
        return done.stdout

    def refuses(self, message, *words, code=1):
        done = subprocess.run(self.command(*words), capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, code, done.stderr)
        self.assertRegex(done.stderr, message)
        self.assertTrue(done.stderr.splitlines()[-1].startswith('experiment.py: '), done.stderr)
        return done

    def calls(self, command=''):
        path = os.path.join(self.here, 'bin/calls')
        if not os.path.exists(path):
            return []
        with open(path, encoding='utf-8') as f:
            return [line for line in f.read().splitlines() if line.startswith(command)]

    def json(self, name):
        with open(os.path.join(self.out, name), encoding='utf-8') as f:
            return json.load(f)

    def table(self):
        with open(os.path.join(self.out, 'table.md'), encoding='utf-8') as f:
            return f.read()

    def test_whole(self):
        printed = self.runs()
        self.assertEqual([len(self.calls(c)) for c in ('simulate', 'train', 'evaluate')], [2, 4, 4])
        self.assertIn('LPIPS (alex)', self.table())
        self.assertIn('| no fusion | - |', self.table())
        self.assertIn('| 2 of 2, 0 of 2 |', self.table())
        self.assertIn('- full against no fusion, seeds 1, 2\n  - undecided: ', self.table())
        self.assertIn('DSM MAE m: +33.3, +33.3 % (2 of 2)', self.table())  # two scenes decide nothing
        self.assertIn('Trained by: satsurf 9.8.6 (abb) (4 scores).', self.table())
        self.assertNotIn('in all settings', self.table())
        self.assertTrue(printed.endswith(self.table()))
        self.assertEqual(sorted(os.listdir(self.out)),
                         ['experiment.json', 'heldout', 'runs', 'scores', 'simulate.log', 'table.json', 'table.md', 'train'])
        config = self.json('experiment.json')
        self.assertEqual((config['train_seed'], config['heldout_seed']), (101, 202))
        for folder, seed in (('train', 101), ('heldout', 202)):
            self.assertEqual(sum(f'/{folder} ' in c and f'--seed {seed}' in c for c in self.calls('simulate')), 1)
        record = self.json('scores/no-fusion-2.json')
        self.assertEqual(record['program'], 'satsurf 9.8.7 (abc)')
        self.assertEqual(record['arguments'], '--preset base8 --model.fusion none --steps 5 --crop 96')
        self.assertEqual((record['steps'], record['seed']), (5, 2))
        self.assertEqual(record['config'], {'preset': 'base8', 'steps': 5, 'model': {'fusion': 'none', 'width': 0.1}})
        self.assertNotIn(self.here, json.dumps(record))
        self.assertEqual(self.json('table.json')['scores']['full']['1']['scenes']['A']['dsm_mae'], 1)
        # nothing is made twice
        made = self.calls()
        self.assertEqual(self.runs(), self.table())
        self.assertEqual(self.calls(), made)

    def test_all_begin_with_one_network(self):
        data = b''.join(struct.pack('<4e', *[k] * 4) for k in range(4))
        names = ['model.stage2.fusion.a', 'model.stage2.cost.b', 'surface.c', 'model.stage3.guidance.d']
        header = {'__metadata__': {'format': 'satsurf-1', 'model': '{}', 'step': '9'}}
        header |= {n: {'dtype': 'F16', 'shape': [4], 'data_offsets': [8 * k, 8 * k + 8]} for k, n in enumerate(names)}
        text = json.dumps(header).encode()
        init = os.path.join(self.here, 'trained.safetensors')
        with open(init, 'wb') as f:
            f.write(struct.pack('<Q', len(text)) + text + data)
        self.runs('--init', init, '--preset', 'wide8', '--only', '^(full|no fusion|paper)$')
        with open(os.path.join(self.out, 'begin.safetensors'), 'rb') as f:
            size, = struct.unpack('<Q', f.read(8))
            kept, left = json.loads(f.read(size)), f.read()
        self.assertEqual(kept, {'__metadata__': {'format': 'satsurf-1', 'model': '{}'},
                                'model.stage2.cost.b': {'dtype': 'F16', 'shape': [4], 'data_offsets': [0, 8]}})
        self.assertEqual((size % 8, left), (0, data[8:16]))
        trainings = self.calls('train')
        self.assertEqual(len(trainings), 4)  # paper is built otherwise
        for call in trainings:
            self.assertIn('--preset wide8 ', call)
            self.assertIn(f'--init {self.out}/begin.safetensors', call)
            self.assertNotIn('--mono_weights', call)
        config = self.json('experiment.json')
        self.assertEqual((config['preset'], config['mono']), ('wide8', ''))
        self.assertRegex(config['init'], r'^trained\.safetensors sha256:')

    def test_parts_of_the_search(self):
        init = self.put('base.safetensors', 'weights')
        self.runs('--study', 'parts', '--init', init, '--seeds', '1', '--only', '^(full|bilinear|none)')
        trainings = self.calls('train')
        self.assertEqual(len(trainings), 3)
        for call, words in zip(trainings, ('--preset wide8 ', '--model.centre bilinear ', '--preset base8 ')):
            self.assertIn(words, call)
            self.assertIn(f'--init {init} ', call)  # as it is
            self.assertIn('--colour_weight 0 --ssim_weight 0 --render_height_weight 0 --lpips_weight 0 ', call)
        self.assertTrue(all(call.endswith('--no-meshes') for call in self.calls('evaluate')))
        config = self.json('experiment.json')
        self.assertEqual((config['study'], config['mono'], 'preset' in config), ('parts', '', False))
        self.assertIn('| variant | source MAE m |', self.table())
        self.assertEqual(list(self.json('table.json')['gains_of_full']), ['bilinear centres', 'none of the parts'])
        self.refuses('is of another experiment', '--init', init)
        self.refuses('--preset: needs --init, and is not for', '--study', 'parts', '--init', init, '--preset', 'wide8')

    def test_only_keeps_other_rows(self):
        self.runs('--seeds', '1')
        self.runs('--only', '^full$', '--seeds', '2')
        self.assertEqual(list(self.json('table.json')['scores']), ['full', 'no fusion'])
        self.assertEqual(self.json('table.json')['experiment']['seeds'], [1, 2])
        self.assertIn('full against no fusion, seed 1\n  - one seed: ', self.table())

    def test_modules(self):
        self.runs('--only', '^(full|no |none )', '--seeds', '1')
        self.assertEqual(len(self.calls('train')), 8)
        self.assertRegex(self.table(),
                         r'\n- fusion in all settings of the others, seed 1\n  - one seed: .*DSM MAE m: \+9\.6 %')
        modules = self.json('table.json')['gains_of_modules']
        self.assertEqual(list(modules), ['fusion', 'guidance', 'routing'])  # full is 1, all others 1.5
        self.assertAlmostEqual(modules['fusion']['columns']['dsm_mae']['gains'][0], 100 * (1 - 1.5**-0.25))
        self.assertEqual(list(self.json('table.json')['gains_of_full'])[0], 'no fusion')

    def test_scores_without_a_record_are_taken(self):
        self.runs()
        for name in os.listdir(os.path.join(self.out, 'scores')):
            if name.endswith('.json'):
                os.remove(os.path.join(self.out, 'scores', name))
        self.put('out/scores/something-1.csv', table('AB', 1))
        made = self.calls()
        done = subprocess.run(self.command(), capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 0)
        self.assertRegex(done.stderr, r'left out: something-1\.csv')
        self.assertEqual(self.calls(), made)
        self.assertIn('Trained by: not recorded (4 scores).', self.table())
        self.assertIn('| 2 of 2, 0 of 2 |', self.table())  # of evaluate's JSON in runs

    def test_scores_of_other_settings_are_refused(self):
        self.runs()
        self.put('bin/config', '{"routing": "none", "model": {"fusion": "cmmf", "width": 0.2}}')  # the preset changed
        self.refuses(r'full-1\.csv: made with other settings: config\.model\.width is 0\.1, wanted 0\.2; remove it')
        os.remove(os.path.join(self.here, 'bin/config'))
        record = self.json('scores/full-1.json')
        for key, value in (('arguments', '--preset tiny'), ('seed', 3), ('steps', 6)):
            with self.subTest(key):
                self.put('out/scores/full-1.json', json.dumps(record | {key: value}))
                self.refuses(rf'full-1\.csv: made with other settings: {key} is {value!r}, wanted ')
        self.put('out/scores/full-1.json', json.dumps(record)[:50])
        self.refuses(r'full-1\.json: not whole JSON')

    def test_networks_of_other_settings_are_refused(self):
        self.runs('--only', '^full$', '--seeds', '1')
        os.remove(os.path.join(self.out, 'scores/full-1.csv'))
        self.put('bin/config', '{"preset": "base9"}')
        self.refuses(r"runs/full-1: made with other settings: config\.preset is 'base8', wanted 'base9'",
                     '--only', '^full$', '--seeds', '1')

    def test_other_scenes_are_refused(self):
        self.runs('--seeds', '1')
        self.put('out/scores/full-2.csv', table('AC', 1))
        self.refuses(r'full-2\.csv and .*full-1\.csv are of different scenes: B, C in one of them alone', '--seeds', '1')

    def test_configuration(self):
        self.runs('--seeds', '1')
        config = self.json('experiment.json')
        old = {k: v for k, v in config.items() if not k.endswith('_seed')}
        self.assertEqual(list(old), ['steps', 'crop', 'scenes', 'heldout', 'pixels', 'mono', 'lpips'])
        self.put('out/experiment.json', json.dumps(old))
        self.runs('--seeds', '1')
        self.assertEqual(self.json('experiment.json'), old)  # stays as it was recorded
        self.refuses(r'is of another experiment: crop is 96, wanted 64; give another OUT', '--crop', '64')
        self.put('out/experiment.json', json.dumps(config | {'train_seed': 7}))
        self.refuses(r'train_seed is 7, wanted 101')
        for text in ('', json.dumps(config)[:40]):
            self.put('out/experiment.json', text)
            self.refuses(r'experiment\.json: not whole JSON')
        self.put('out/experiment.json', '[]')
        self.refuses(r'experiment\.json: expected a JSON object')

    def test_arguments(self):
        for words, code, message in (
                (['--jobs', '0'], 2, '--jobs: 0, expected 1 or more'), (['--steps', '0'], 2, '--steps: 0, expected 1'),
                (['--mono', self.here + '/no'], 1, "--mono: no file '.*no'"), (['--mono', ''], 1, "--mono: no file ''"),
                (['--lpips', self.here + '/no'], 1, "--lpips: no file '.*no'"),
                (['--satsurf', self.here], 1, 'no program'), (['--only', '('], 1, 'no regular expression'),
                (['--only', 'nothing'], 1, 'finds none of the variants')):
            with self.subTest(words):
                self.refuses(message, *words, code=code)
                self.assertFalse(os.path.exists(self.out))
        self.assertEqual(self.calls(), [])

    def test_a_failure_ends_the_queue(self):
        self.put('bin/fail', '')
        self.refuses('train failed with 3; see .*full-1.log')
        self.assertEqual(len(self.calls('train')), 1)

    def test_a_signal_ends_the_queue(self):
        self.put('bin/wait', '')
        for number, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
            with self.subTest(number):
                before = len(self.calls('train'))
                # a shell may have had SIGINT ignored
                child = subprocess.Popen(self.command('--jobs', '2'), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                                         text=True, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
                until = time.monotonic() + 30
                while len(self.calls('waits')) < before + 2 and time.monotonic() < until:
                    time.sleep(0.02)
                child.send_signal(number)
                _, said = child.communicate(timeout=30)
                self.assertEqual(child.returncode, code, said)
                self.assertNotIn('Traceback', said)
                self.assertEqual(len(self.calls('train')) - before, 2)
                self.assertEqual(len(self.calls('stopped')) - before, 2)
                self.assertEqual(self.calls('evaluate'), [])


if __name__ == '__main__':
    unittest.main()
