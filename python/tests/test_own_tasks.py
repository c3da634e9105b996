"""Tasks of the library that are written again in Python: the same programs, so the same bits and the same speed."""

import json

import numpy as np
import own_tasks
import pytest
from conftest import near_hover

import omnidrones
from omnidrones import _core

OWN = {own.__name__: type("Own" + own.__name__, (own,), {}) for own in own_tasks.TASKS}
KEYWORDS = {"seed": 3, "threads": 1}


def both(name, n_env, **keywords):
    """The task of the library, and the one in Python."""
    return [omnidrones.make(task, n_env, **KEYWORDS, **keywords) for task in (name, OWN[name])]


@pytest.mark.parametrize("name", OWN)
def test_a_task_in_python_is_recorded_as_the_same_programs(name):
    built_in, own = both(name, 2)
    theirs, ours = dict(built_in._printed()), dict(own._printed())
    assert list(ours) == list(theirs)
    for program, text in theirs.items():
        pairs = zip(ours[program].splitlines(), text.splitlines())
        differing = [f"line {k}: {a} | {b}" for k, (a, b) in enumerate(pairs) if a != b][:5]
        assert ours[program] == text, f"{program}: {differing}"


@pytest.mark.parametrize("name", OWN)
def test_a_task_in_python_says_the_same_of_itself(name):
    built_in, own = both(name, 2)
    apart = {"task", "name", "description", "config"}
    theirs, ours = ({key: value for key, value in env.spec.data.items() if key not in apart} for env in (built_in, own))
    assert ours == theirs
    theirs, ours = (json.loads(_core._task_spec(env.spec.task)) for env in (built_in, own))
    for spec in (theirs, ours):
        # in the order of their definition, which is another one
        spec["settings"] = {setting["key"]: setting for setting in spec["settings"]}
    for key in set(theirs) - apart:
        assert ours[key] == theirs[key], key


@pytest.mark.parametrize("name", OWN)
def test_a_task_in_python_flies_the_same_bits(name):
    envs = both(name, 16)
    first = [env.reset() for env in envs]
    assert first[0].tobytes() == first[1].tobytes()
    rng, ended = np.random.default_rng(5), 0
    for t in range(300):
        actions = near_hover(rng, envs[0], 1.0)
        steps = [env.step(actions) for env in envs]
        for what, theirs, ours in zip(steps[0]._fields, *steps, strict=True):
            assert theirs.tobytes() == ours.tobytes(), f"{what} of step {t}"
        ended += int(steps[0].terminated.sum())
    assert ended > 3, "episodes end and begin"


@pytest.mark.parametrize("name", OWN)
def test_a_task_in_python_has_the_same_gradients(name):
    swept = []
    for env in both(name, 3):
        env.reset()
        rng, tape, sweep, ones = np.random.default_rng(7), env.tape(4), env.adjoint().sweep(), np.ones(3, np.float32)
        for _ in range(4):
            env.step_recorded(near_hover(rng, env), tape)
        swept.append([sweep.pull(tape, t, reward=ones, loss=ones).copy() for t in reversed(range(4))])
    assert np.abs(swept[0]).max() > 0.0
    assert np.array(swept[0]).tobytes() == np.array(swept[1]).tobytes()


class Picks(omnidrones.Task):
    """Begins at different places."""

    success_rule = omnidrones.Success().below("height", 0.1)

    def start(self, start):
        first = start.reset.below(5)
        start.place([first, start.reset.below(5, other_than=[first]), 2.0])

    def ideal(self, start):
        start.place([0.0, 0.0, 2.0])

    def observe(self, view, agent, out):
        out.field("place", "m, world", "p", view.drone().position)

    def reward(self, view, terms):
        terms.term("alive", "1", 1.0, 1.0)

    def ends(self, view, ends):
        pass

    def metrics(self, view, out):
        out.metric("height", "m", view.drone().position[2])


def test_what_only_the_host_draws_asks_for_a_start_on_the_host():
    with pytest.raises(ValueError, match="start_on_host = True"):
        omnidrones.make(Picks, 2)
    places = omnidrones.make(type("OnHost", (Picks,), {"start_on_host": True}), 200, threads=1).reset()[:, 0]
    assert set(places[:, 0]) == set(places[:, 1]) == {0.0, 1.0, 2.0, 3.0, 4.0} and (places[:, 0] != places[:, 1]).all()

    def full(self, start):
        start.place([start.reset.below(1, other_than=[0.0]), 0.0, 2.0])

    with pytest.raises(ValueError, match="numbers in other_than"):
        omnidrones.make(type("Full", (Picks,), {"start": full}), 2)


def test_a_gate_is_as_far_as_its_nearest_bar():
    gate, frame = omnidrones.Gate(half_width=1.0, half_height=0.5, radius=0.1, scale=1.0), ([0.0, 0.0, 2.0], own_tasks.LEVEL)
    assert (gate.radius, gate.opening, gate.data["half_width"]) == (0.1, [0.9, 0.4], 1.0)

    def step(x, u):
        return np.stack([gate.distance(*frame, u), *gate.passage(*frame, u, u + [2.0, 0.0, 0.0])])

    system = omnidrones.System.of(step, states=3, inputs=3)
    distance, direction, margin = system.trajectory(np.zeros(3), np.array([[-1.0, 0.8, 2.0]]))[1]
    assert abs(distance - (np.hypot(1.0, 0.2) - 0.1)) < 1e-12 and direction == 1.0 and abs(margin - 0.1) < 1e-12
    with pytest.raises(ValueError, match="leave an opening"):
        omnidrones.Gate(radius=1.0)
