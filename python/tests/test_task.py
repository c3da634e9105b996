"""Tasks that are classes: asked once, as good as the library's own, and every mistake told with its line."""

import concurrent.futures
import gc
import os
import pickle
import subprocess
import sys
import threading
import types
from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

import omnidrones
from omnidrones import RecordingError, Setting, Success, Task, functions

LINE = Path(__file__).name


class Rise(Task):
    """Rise to a height.

    z height of the drone, h = {height} m − z.
    """

    horizon = 100
    height = Setting(3.0, "m, world", "to rise to", domain="positive")
    success_rule = Success().below("height_error", 0.1)

    def left(self, view):
        return self.height - view.drone().position[2]

    def start(self, start):
        start.place(np.stack([0.0, 0.0, start.reset.uniform(1.0, 2.0)]))

    def ideal(self, start):
        start.place([0.0, 0.0, self.height])

    def observe(self, view, agent, out):
        out.field("left", "m, world", "h", self.left(view))
        out.observe_drone(view)

    def reward(self, view, terms):
        terms.term("near", "1/(1 + h²)", 1.0, 1.0 / (1.0 + self.left(view) ** 2))

    def ends(self, view, ends):
        ends.when("crash", "z < 0.2 m", view.drone().position[2] < 0.2)

    def metrics(self, view, out):
        out.metric("height_error", "m", abs(self.left(view)))


def made(**changes):
    """`Rise` with other methods and attributes."""
    return type("Changed", (Rise,), changes | {"__module__": __name__})


def stepped(env, n=20):
    """Rows of so many random steps."""
    env.reset(seed=3)
    rows = []
    for t in range(n):
        step = env.step(env.sample(t))
        rows.append(np.concatenate([step.observation.ravel(), step.reward.ravel(), step.info.ravel()]))
    return np.array(rows)


def test_a_class_is_a_task_with_the_spec_that_it_writes():
    env = omnidrones.make(Rise, 8, height=2.5)
    spec = env.spec
    assert spec.task == "Rise" and "Rise" in omnidrones.tasks()
    assert [field.name for field in spec.observation][:2] == ["left", "attitude"]
    assert "reward_near" in spec.info and "height_error" in spec.info
    observation = env.reset(seed=0)
    heights = env.states()[:, 2]
    assert np.allclose(observation[:, 0, 0], 2.5 - heights) and np.all((1.0 <= heights) & (heights <= 2.0))
    step = env.step(env.sample(0))
    left = step.observation[:, 0, 0]
    assert np.allclose(step.reward[:, 0], 1.0 / (1.0 + left**2))
    assert np.allclose(env.column("height_error"), np.abs(left))


def test_a_task_is_asked_once_per_settings_whatever_is_made_of_it():
    asked = []

    def reward(self, view, terms):
        asked.append(1)
        Rise.reward(self, view, terms)

    task = made(reward=reward, name="AskedOnce")
    env = omnidrones.make(task, 8)
    n = len(asked)
    # as a summand of the default loss, too
    assert n == 2
    env.reset(seed=0)
    for t in range(150):
        env.step(env.sample(t))
    env.adjoint()
    omnidrones.make("AskedOnce", 64, autoreset="next_step")
    omnidrones.train("AskedOnce", algorithm="apg", apg={"updates": 3, "n_env": 32, "horizon": 8}, evaluate={"envs": 32})
    assert len(asked) == n
    omnidrones.make("AskedOnce", 8, height=1.5)
    assert len(asked) == 2 * n


def test_training_never_calls_python():
    task = made(name="Poisoned")
    omnidrones.make(task, 1)

    def poison(*_):
        raise AssertionError("Python was called")

    for method in ("reward", "observe", "ends", "start", "ideal", "metrics"):
        setattr(task, method, poison)
    run = omnidrones.train(
        "Poisoned", algorithm="ppo", threads=2, ppo={"updates": 2, "n_env": 64, "steps": 16}, evaluate={"envs": 32}
    )
    assert run.updates == 2 and np.isfinite(run.evaluation["return_mean"])


def test_no_reference_to_what_was_lent_outlives_its_call():
    kept = {}

    def observe(self, view, agent, out):
        kept.update(view=view, out=out, number=view.drone().position[2])
        Rise.observe(self, view, agent, out)

    def start(self, start):
        kept.update(start=start)
        Rise.start(self, start)

    omnidrones.make(made(observe=observe, start=start, name="Leaking"), 2)
    with pytest.raises(RecordingError, match=LINE):
        kept["number"] + 1.0
    with pytest.raises(RecordingError, match=LINE):
        kept["view"].drone()
    with pytest.raises(RecordingError, match=LINE):
        kept["out"].field("late", "m", "too late", 1.0)
    with pytest.raises(RuntimeError, match="lent for one call"):
        kept["out"].unnamed(lambda out: None)
    with pytest.raises((RuntimeError, RecordingError)):
        kept["start"].place([0.0, 0.0, 1.0])


def test_an_exception_is_itself_and_leaves_nothing_behind():
    class Own(Exception):
        pass

    def reward(self, view, terms):
        view.drone().position + 1.0
        raise Own("half way")

    task = made(reward=reward, name="Raising")
    for _ in range(3):
        with pytest.raises(Own, match="half way") as raised:
            omnidrones.make(task, 2)
        assert any(Path(str(entry.path)).name == LINE and entry.name == "reward" for entry in raised.traceback)
    assert np.array_equal(stepped(omnidrones.make(Rise, 4)), stepped(omnidrones.make(Rise, 4)))


def test_make_within_a_recording_works():
    within = []

    def reward(self, view, terms):
        within.append(stepped(omnidrones.make(Rise, 4), 3))
        Rise.reward(self, view, terms)

    env = omnidrones.make(made(reward=reward, name="Nested"), 4)
    plain = omnidrones.make(Rise, 4)
    assert np.array_equal(stepped(env, 3), stepped(plain, 3)) and np.array_equal(within[0], stepped(plain, 3))


def test_a_class_written_anew_takes_the_place_of_the_old_one():
    first = omnidrones.make(made(name="Twice"), 2)

    def reward(self, view, terms):
        terms.term("half", "1/2", 0.5, 0.5)

    second = omnidrones.make(made(name="Twice", reward=reward), 2)
    assert "reward_near" in first.spec.info and "reward_half" in second.spec.info
    assert "reward_half" in omnidrones.make("twice", 2).spec.info
    first.reset(seed=0)
    first.step(first.sample(0))


def test_functions_take_the_place_of_phases_of_a_task_of_the_library():
    def reward(view, terms):
        d = functions.norm(view.goal_field("target_heading") - view.drone().heading)
        terms.term("turn", "e^−d", 1.0, np.exp(-d))

    own, whole = omnidrones.make("Hover", 16, reward=reward), omnidrones.make("Hover", 16)
    assert own.spec.task == "Hover-reward" and "reward_turn" in own.spec.info and "reward_pose" not in own.spec.info
    own.reset(seed=1)
    whole.reset(seed=1)
    for t in range(60):
        a, b = own.step(own.sample(t)), whole.step(whole.sample(t))
        assert np.array_equal(a.observation, b.observation) and np.array_equal(a.terminated, b.terminated)
    # the loss follows the reward
    assert np.allclose(own.column("loss"), -own.reward[:, 0])
    ends = omnidrones.make("Hover", 2, ends=lambda view, ends: ends.when("low", "z < 1 m", view.drone().position[2] < 1.0))
    assert ends.spec.ends == ("low", "diverged") if hasattr(ends.spec, "ends") else True
    of_class = omnidrones.make(Rise, 2, reward=reward_of_rise)
    assert "reward_one" in of_class.spec.info


def reward_of_rise(view, terms):
    terms.term("one", "1", 1.0, 1.0)


def test_events_disturbances_and_memory_do_what_they_say():
    def start(self, start):
        start.place([0.0, 0.0, 2.0])
        start.goal.field("height", "m, world", "to hold", 2.0)
        start.event_at = 5.0

    def event(self, start):
        start.goal["height"] = start.goal[0] + 0.5
        start.event_at = start.event_at + 5.0

    def ideal(self, start):
        start.place([0.0, 0.0, 2.0])
        start.goal.field("height", "m, world", "to hold", 2.0)

    def left(self, view):
        return view.goal_field("height") - view.drone().position[2]

    def disturb(self, view, tree):
        return np.stack([3.0, 0.0, 0.0] + [0.0] * 6)

    def remember(self, view, out):
        out.field("steps", "-", "so far", view.kept("steps") + 1.0)

    def metrics(self, view, out):
        out.metric("height_error", "m", abs(self.left(view)))
        out.metric("steps", "-", view.kept("steps"))
        out.metric("goal", "m", view.goal[0])

    task = made(
        start=start, event=event, ideal=ideal, left=left, disturb=disturb, remember=remember, metrics=metrics, name="Busy"
    )
    env = omnidrones.make(task, 3)
    env.reset(seed=0)
    goals, steps = [], []
    for _ in range(12):
        env.step(np.full((3, 1, 4), -0.4, np.float32))
        goals.append(env.column("goal")[0])
        steps.append(env.column("steps")[0])
    assert steps == [float(k) for k in range(1, 13)]
    assert goals == [2.0] * 5 + [2.5] * 5 + [3.0] * 2
    assert np.all(env.states()[:, 3] > 0.0), "the wind blows along x"


def test_pickles_carry_the_task_by_value(tmp_path):
    env = omnidrones.make(Rise, 16, height=2.2)
    env.reset(seed=5)
    env.step(env.sample(0))
    (tmp_path / "env.pkl").write_bytes(pickle.dumps(env))
    np.save(tmp_path / "then.npy", env.step(env.sample(1)).observation)
    code = (
        "import pickle, numpy as np, pathlib\n"
        f"here = pathlib.Path({str(tmp_path)!r})\n"
        "env = pickle.loads((here / 'env.pkl').read_bytes())\n"
        "assert np.array_equal(env.step(env.sample(1)).observation, np.load(here / 'then.npy'))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    again = pickle.loads(pickle.dumps(env))
    assert np.array_equal(again.step(again.sample(2)).observation, env.step(env.sample(2)).observation)


def test_a_run_keeps_its_task(tmp_path):
    settings = {"apg": {"updates": 4, "n_env": 32, "horizon": 8}, "evaluate": {"envs": 32}, "height": 2.4}
    run = omnidrones.train(Rise, algorithm="apg", folder=tmp_path / "run", **settings)
    code = (
        "import omnidrones\n"
        f"policy = omnidrones.load_policy({str(tmp_path / 'run')!r})\n"
        "told = omnidrones.evaluate(policy, num_envs=32)\n"
        "print(repr(told['return_mean']))\n"
    )
    told = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert float(told) == run.evaluation["return_mean"]

    def reward(self, view, terms):
        terms.term("near", "1/(1 + h²)", 1.0, 0.5 / (1.0 + self.left(view) ** 2))

    with pytest.raises(ValueError, match="task_record"):
        omnidrones.train(made(reward=reward, name="Rise"), algorithm="apg", folder=tmp_path / "run", resume=True, **settings)
    omnidrones.register(Rise)
    omnidrones.train(Rise, algorithm="apg", folder=tmp_path / "run", resume=True, **settings)


def test_threads_make_tasks_side_by_side():
    def rows(k):
        return stepped(omnidrones.make(made(name=f"Side{k}"), 4), 5)

    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        all_rows = list(pool.map(rows, range(8)))
    assert all(np.array_equal(own, all_rows[0]) for own in all_rows)


def test_environments_let_go_of_a_class():
    for k in range(40):
        omnidrones.make(made(name="Again", k=k), 1)
    gc.collect()
    assert len([own for own in gc.get_objects() if isinstance(own, type) and own.__name__ == "Changed"]) < 40


# --- a name may come to mean something else; what was made stays what it was ---------------------------------------------------------


def paid(bonus, **more):
    """A task that pays so much in every step."""
    return made(reward=lambda self, view, terms: terms.term("alive", "b", 1.0, bonus), name="Paid", **more)


SHORT = {"algorithm": "apg", "apg": {"updates": 2, "n_env": 32, "horizon": 8}, "evaluate": {"envs": 32}}


def test_policies_runs_and_pickles_keep_the_class_that_they_were_trained_with(tmp_path):
    run = omnidrones.train(paid(0.25), folder=tmp_path / "run", **SHORT)
    old = pickle.dumps(run.policy)
    new = paid(0.75)
    omnidrones.make(new, 1)
    then = run.evaluation["return_mean"]
    for policy in (run.policy, pickle.loads(old), omnidrones.load_policy(tmp_path / "run"), pickle.loads(pickle.dumps(run.policy))):
        assert omnidrones.evaluate(policy, num_envs=32)["return_mean"] == then
    assert omnidrones.evaluate(run.policy, new, num_envs=32)["return_mean"] == pytest.approx(3 * then)


def test_a_class_that_is_written_anew_while_it_trains_changes_nothing_of_the_run(tmp_path):
    plain = omnidrones.train(paid(0.25), **SHORT)
    run = omnidrones.train(
        paid(0.25), folder=tmp_path / "run", watch=lambda _: omnidrones.register(paid(0.75)) and None, **SHORT
    )
    assert run.evaluation["return_mean"] == plain.evaluation["return_mean"]
    assert omnidrones.evaluate(omnidrones.load_policy(tmp_path / "run"), num_envs=32)["return_mean"] == run.evaluation["return_mean"]


def test_classes_of_one_name_in_many_threads_stay_apart():
    def bonus(k):
        env = omnidrones.make(paid(0.1 * k), 2)
        env.reset(seed=0)
        return float(env.step(env.sample(0)).reward[0, 0])

    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        told = list(pool.map(bonus, range(1, 9)))
    assert told == pytest.approx([0.1 * k for k in range(1, 9)])


def test_case_does_not_matter_to_names():
    def one(view, terms):
        terms.term("one", "1", 1.0, 1.0)

    def half(view, terms):
        terms.term("half", "1/2", 1.0, 0.5)

    info = [omnidrones.make(name, 1, reward=own).spec.info for name, own in [("Hover", one), ("hover", half), ("HOVER", one)]]
    assert ["reward_one" in own for own in info] == [True, False, True]
    upper, lower = made(name="CaseOf"), made(name="caseof", reward=lambda self, view, terms: one(view, terms))
    omnidrones.make(upper, 1), omnidrones.make(lower, 1)
    assert "reward_near" in omnidrones.make(upper, 1).spec.info
    assert "reward_half" in omnidrones.make("CASEOF", 1, reward=half).spec.info


def test_what_a_class_is_shown_is_what_environments_have():
    task = made(reward=lambda self, view, terms: terms.term("dt", "dt", 1.0, self.dt), name="Shown")
    for how in ({"dt": 0.02}, {"dt": 0.04, "control_rate": 2}, {"dt": 0.02}):
        env = omnidrones.make(task, 1, **how)
        env.reset(seed=0)
        assert env.step(env.sample(0)).reward[0, 0] == pytest.approx(how["dt"])
    vehicle = omnidrones.Vehicle("crazyflie")
    assert omnidrones.make(task, 1, vehicle=vehicle)._printed() != omnidrones.make(task, 1)._printed()


def test_a_loss_of_a_class_gives_way_to_another_reward():
    task = made(loss=lambda self, view, loss: loss.add("1", 0.654321), name="Losing")
    env = omnidrones.make(task, 4, reward=lambda view, terms: terms.term("one", "1", 1.0, 0.25))
    env.reset(seed=0)
    env.step(env.sample(0))
    assert np.allclose(env.column("loss"), -0.25)


def test_wind_blows_on_a_task_that_knows_of_none():
    env = omnidrones.make(Rise, 4, randomise=[{"what": "wind", "by": "set", "range": [3.0, 3.0]}])
    env.reset(seed=0)
    for t in range(20):
        env.step(env.sample(t))


def test_what_asks_for_itself_is_refused():
    def robot(self):
        return omnidrones.Robot.of_task("AskingItself")

    with pytest.raises(ValueError):
        omnidrones.make(made(robot=robot, name="AskingItself"), 1)

    def observe(self, view, agent, out):
        omnidrones.make("WithinItself", 1)
        Rise.observe(self, view, agent, out)

    with pytest.raises(ValueError, match="within its own recording"):
        omnidrones.make(made(observe=observe, name="WithinItself"), 1)


# --- mistakes: an exception with the line of the user and what to write instead -------------------------------------------------------

kept_number = []


def leak(self, view, terms):
    if kept_number:
        terms.term("old", "x", 1.0, kept_number[0])
    else:
        kept_number.append(view.drone().position[2])
        Rise.reward(self, view, terms)


def by_thread(self, view, terms):
    told, z = [], view.drone().position[2]

    def work():
        try:
            told.append(z + 1.0)
        except BaseException as error:
            told.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    raise told[0]


def generator(self, view, terms):
    def own():
        yield view.drone().position[2]

    global left_over
    left_over = own()
    Rise.reward(self, view, terms)


MISTAKES = {
    "a branch on a number": (
        {"reward": lambda self, view, terms: terms.term("x", "x", 1.0, 1.0 if self.left(view) > 0 else 0.0)},
        RecordingError,
        "np.where",
    ),
    "float of a number": (
        {"reward": lambda self, view, terms: terms.term("x", "x", 1.0, float(self.left(view)))},
        RecordingError,
        LINE,
    ),
    "a loop until something is small": (
        {"reward": lambda self, view, terms: [None for _ in iter(lambda: self.left(view) < 0.1, True)]},
        RecordingError,
        "",
    ),
    "a number of another thread": ({"reward": by_thread}, RecordingError, LINE),
    "wrong shape of a term": (
        {"reward": lambda self, view, terms: terms.term("x", "x", 1.0, view.drone().position)},
        RecordingError,
        "summand 'x'",
    ),
    "wrong shape of a place": ({"start": lambda self, start: start.place([0.0, 0.0])}, RecordingError, "position"),
    "a constant that is NaN": (
        {"reward": lambda self, view, terms: terms.term("x", "x", 1.0, self.left(view) * np.nan)},
        RecordingError,
        "NaN",
    ),
    "draws in the reward": (
        {"reward": lambda self, view, terms: terms.term("x", "x", 1.0, view.reset.uniform(0.0, 1.0))},
        AttributeError,
        "reset",
    ),
    "an exception half way": ({"observe": lambda self, view, agent, out: 1 / 0}, ZeroDivisionError, "division"),
    "a reward without a bound": (
        {"reward": lambda self, view, terms: terms.term("x", "x", np.inf, self.left(view))},
        ValueError,
        "Rewards are bounded",
    ),
    "a term twice": (
        {"reward": lambda self, view, terms: Rise.reward(self, view, terms) or Rise.reward(self, view, terms)},
        ValueError,
        "'near'",
    ),
    "a setting of no kind": ({"height": Setting({"a": None}, "m", "x")}, (TypeError, ValueError), "height"),
    "a setting outside of its domain": ({"height": Setting(-1.0, "m", "x", domain="positive")}, ValueError, "> 0"),
    "an unknown domain": ({"height": Setting(1.0, "m", "x", domain="postive")}, ValueError, "positive"),
    "no ends": ({"ends": None}, TypeError, "def ends"),
    "no reward": ({"reward": None}, TypeError, "def reward"),
    "an end that is a number": (
        {"ends": lambda self, view, ends: ends.when("x", "x", view.drone().position[2])},
        (TypeError, ValueError),
        "end 'x'",
    ),
    "a success by a figure that is none": ({"success_rule": Success().below("errr", 0.1)}, ValueError, "height_error"),
    "a robot that is none": ({"robot": lambda self: "hummingbird"}, TypeError, "omnidrones.Robot"),
    "a vehicle that is none": ({"vehicle": "humingbird"}, ValueError, "hummingbird"),
    "a drone that is not there": (
        {"observe": lambda self, view, agent, out: out.observe_drone(view, 3)},
        ValueError,
        "drone is 3",
    ),
    "a field without numbers' names": ({"observe": lambda self, view, agent, out: out.write(1.0)}, ValueError, "name of a"),
    "goals of a start unlike the ideal's": (
        {"start": lambda self, start: (start.goal.field("a", "m", "x", 1.0), Rise.start(self, start))},
        ValueError,
        "ideal",
    ),
    "a part that is drawn again twice": (
        {"start": lambda self, start: [start.again(3, lambda: start.reset.unit() < 0.5) for _ in range(2)]},
        ValueError,
        "one part",
    ),
    "a goal that is not there": (
        {"observe": lambda self, view, agent, out: out.field("x", "m", "x", view.goal_field("target"))},
        ValueError,
        "target",
    ),
    "a setting that environments have": ({"dt": Setting(7.0, "s", "x")}, ValueError, "Name it otherwise"),
    "an event that writes another goal": (
        {"event": lambda self, start: start.goal.field("a", "m", "x", 1.0)},
        ValueError,
        "start.goal['a'] = numbers",
    ),
    "a reward that is returned": ({"reward": lambda self, view, terms: self.left(view)}, TypeError, "terms.term("),
    "a reward of nothing": ({"reward": lambda self, view, terms: None}, ValueError, "one or more"),
    "an observation that is returned": ({"observe": lambda self, view, agent, out: self.left(view)}, TypeError, "out.field("),
    "a figure without a number": (
        {"metrics": lambda self, view, out: out.field("height_error", "m", "x")},
        ValueError,
        "height_error",
    ),
    "a layout of more numbers than there are": (
        {"observe": lambda self, view, agent, out: out.field("a", "m", "x", 1.0, layout=("image", 2**33, 2**33, 2))},
        ValueError,
        "'a'",
    ),
    "a start that is drawn a million times": (
        {"start": lambda self, start: start.again(10**6, lambda: start.reset.unit() < 0.5)},
        ValueError,
        "attempts",
    ),
    "disturbances on what nothing may act on": (
        {"disturb": lambda self, view, tree: np.zeros(9), "robot": lambda self: omnidrones.Robot.of_task("Hover")},
        ValueError,
        "'disturb'",
    ),
    "a rule of success without limits": ({"success_rule": Success()}, TypeError, "with a limit"),
    "a limit that is no number": ({"success_rule": lambda self: Success().below("height_error", np.nan)}, ValueError, "finite"),
    "a horizon that is no number of steps": ({"horizon": 10.5}, ValueError, "horizon"),
    "a field of the task state that is not kept": (
        {"remember": lambda self, view, out: out.field("steps", "-", "x", view.kept("stesp"))},
        ValueError,
        "steps",
    ),
    "equality of numbers": (
        {"ends": lambda self, view, ends: ends.when("x", "x", view.step == 3.0)},
        RecordingError,
        LINE,
    ),
    "a horizon of none": ({"horizon": 0}, ValueError, "horizon"),
    "a method that takes too little": ({"observe": lambda self, view: None}, TypeError, "positional argument"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_with_its_line_and_a_remedy(mistake):
    changes, kind, words = MISTAKES[mistake]
    with pytest.raises(kind) as raised:
        omnidrones.make(made(**changes, name="Mistaken"), 2)
    assert words in str(raised.value), raised.value
    assert any(Path(str(entry.path)).name == LINE for entry in raised.traceback)
    # and nothing of it stays
    assert np.isfinite(stepped(omnidrones.make(Rise, 2), 2)).all()


def test_a_number_of_an_earlier_recording_is_refused():
    kept_number.clear()
    task = made(reward=leak, name="Leak")
    with pytest.raises(RecordingError, match="another"):
        omnidrones.make(task, 2)


def test_a_generator_that_goes_on_later_is_refused():
    omnidrones.make(made(reward=generator, name="Generating"), 2)
    with pytest.raises(RecordingError, match=LINE):
        next(left_over) + 1.0


def test_a_function_for_no_phase_is_refused_with_the_phase_that_is_meant():
    with pytest.raises(ValueError, match="reward"):
        omnidrones.make("Hover", 1, reword=lambda view, terms: None)
    with pytest.raises(TypeError, match="load_policy"):
        omnidrones.evaluate("runs/own")
    assert omnidrones.recipes(Rise) == ["apg"]


def test_names_of_the_library_are_not_taken():
    with pytest.raises(ValueError, match="not taken"):
        omnidrones.register(made(name="Hover"))
    with pytest.raises(ValueError, match="letters"):
        omnidrones.register(made(name="my task"))
    with pytest.raises(TypeError, match="Pass the class"):
        omnidrones.make(Rise(), 2)
    with pytest.raises(TypeError, match="no task"):
        omnidrones.make(7, 2)


# --- whatever a method does, it is a task or an exception -------------------------------------------------------------------------------

# 10000 for the whole number: HYPOTHESIS_CALLS=10000 .ci/python -k random_methods
CALLS = int(os.environ.get("HYPOTHESIS_CALLS", "300"))
THINGS = st.one_of(
    st.none(), st.booleans(), st.integers(-3, 9), st.floats(), st.text(max_size=4), st.just([]), st.just([1.0, 2.0, 3.0]),
    st.just([0.0] * 9), st.just(np.zeros((3, 2))), st.just(np.eye(3)), st.just(slice(0, 3)), st.just(lambda *_: None),
)
REFUSED = (TypeError, ValueError, OverflowError, RuntimeError, AttributeError, IndexError, KeyError, ZeroDivisionError, MemoryError)
FUNCTIONS = types.SimpleNamespace(**{name: getattr(functions, name) for name in functions.__all__})
METHODS = ["start", "ideal", "observe", "reward", "ends", "metrics", "loss", "event", "remember", "success", "disturb"]
METHODS += ["central", "reference", "robot"]


def members(thing):
    return sorted(name for name in dir(thing) if not name.startswith("_"))


def wander(data, things):
    """Calls members of what is at hand, with what is at hand; the result is at hand, too."""
    for _ in range(data.draw(st.integers(0, 6))):
        thing = things[data.draw(st.integers(0, len(things) - 1))]
        names = members(thing)
        if not names:
            continue
        member = getattr(thing, data.draw(st.sampled_from(names)))
        if callable(member):
            given = data.draw(st.lists(st.one_of(THINGS, st.integers(100, 100 + len(things) - 1)), max_size=4))
            given = [things[own - 100] if isinstance(own, int) and own >= 100 else own for own in given]
            member = member(*given)
        things.append(member)
    return things[-1]


@hypothesis.settings(max_examples=CALLS, deadline=None, suppress_health_check=list(hypothesis.HealthCheck), database=None)
@hypothesis.given(st.data())
@pytest.mark.filterwarnings("ignore")
def test_random_methods_make_a_task_or_raise(data):
    def wandering(method):
        def own(self, *given):
            if hasattr(Rise, method) and data.draw(st.booleans()):
                getattr(Rise, method)(self, *given)
            result = wander(data, [*given, self, FUNCTIONS]) if given else data.draw(THINGS)
            return result if data.draw(st.booleans()) else None

        return own

    chosen = data.draw(st.lists(st.sampled_from(METHODS), min_size=1, max_size=3, unique=True))
    task = made(**{method: wandering(method) for method in chosen}, name="Wandering")
    try:
        env = omnidrones.make(task, 2)
    except REFUSED:
        env = omnidrones.make(Rise, 2)
    env.reset(seed=0)
    for t in range(2):
        env.step(env.sample(t))
    env.save()
