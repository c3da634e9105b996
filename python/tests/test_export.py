"""What flew here flies there: C99 that tests itself and is called through ctypes, ONNX in onnxruntime."""

import ctypes
import os
import shutil
import subprocess

import numpy as np
import pytest

import omnidrones

COMPILER = os.environ.get("CC", "cc")
compiled = pytest.mark.skipif(shutil.which(COMPILER) is None, reason=f"no C compiler here ({COMPILER})")

NORMALISED = [{"kind": "history", "steps": 3}, {"kind": "normalise", "clip": 2.0}]
KINDS = {
    "plain": {"algorithm": "apg", "apg": {"n_env": 16, "horizon": 8, "updates": 3}},
    "normalised": {"observation": NORMALISED},
    "memory": {"observation": [{"kind": "normalise"}], "network": {"memory": {"kind": "gru", "units": 7}}},
    "discrete": {"actions": {"kind": "discrete", "levels": 3}},
    "discrete_memory": {"actions": {"kind": "multi_discrete", "levels": 3}, "network": {"memory": {"kind": "gru", "units": 7}}},
}


def trained(kind):
    """A policy that has learnt little, whose outputs differ from state to state."""
    settings = dict(KINDS[kind])
    if "apg" not in settings:
        network = {"hidden": [24, 24], **settings.pop("network", {})}
        ppo = {"n_env": 32, "updates": 2, "network": network, "log_std": -0.5}
        settings |= {"algorithm": "ppo", "ppo": ppo}
    return omnidrones.train("Hover", seed=3, horizon=60, evaluate={"envs": 4}, **settings).policy


@pytest.fixture(scope="module")
def policies():
    made = {}
    return lambda kind: made.setdefault(kind, trained(kind))


def environments(policy, n, raw=False):
    """Those that a policy was trained in, behind its statistics; with `raw` without the stage that normalises."""
    config = dict(policy.config)
    if raw:
        config["observation"] = [own for own in config.get("observation", []) if own["kind"] != "normalise"]
    env = omnidrones.make(policy.task, n, config=config, seed=7, autoreset="disabled", stagger=False, threads=1)
    statistics = policy.__reduce__()[1][3]
    if statistics is not None and not raw:
        env.set_statistics(*statistics)
    env.reset()
    return env


def flown_as(kind, action):
    """What environments make of an action: commands are clipped."""
    return action if "discrete" in kind else np.clip(action, -1, 1)


class Library:
    """A module as a shared library, called with arrays."""

    def __init__(self, module, folder):
        folder = folder / module.name
        module.write(folder)
        library = folder / f"{module.name}.so"
        source = folder / f"{module.name}.c"
        subprocess.run([COMPILER, "-std=c99", "-O1", "-shared", "-fPIC", source, "-lm", "-o", library], check=True)
        self.module, self.library = module, ctypes.CDLL(str(library))
        self.number = {"float": np.float32, "double": np.float64}[module.precision]

    def memory(self):
        own = np.zeros(self.module.memory, np.uint8)
        if own.size:
            self("reset", own)
        return own

    def __call__(self, name, *arrays):
        given = [own for own in arrays if own.size]
        getattr(self.library, f"{self.module.name}_{name}")(*(own.ctypes.data_as(ctypes.c_void_p) for own in given))


@compiled
@pytest.mark.parametrize("precision", ["float", "double"])
def test_one_of_each_kind_compiles_and_tests_itself(precision, policies):
    env = omnidrones.make("Hover", 4, horizon=50)
    filters = [{"kind": "low_pass", "frequency": 80.0}]
    modules = [
        omnidrones.export_c("hummingbird", precision=precision),
        omnidrones.export_c(omnidrones.Vehicle("firefly"), dt=0.001, precision=precision),
        omnidrones.export_c("payload", precision=precision),
        omnidrones.export_c("hummingbird", controller="indi", precision=precision),
        omnidrones.export_c("iris", controller="cascade", rates={"velocity": 50.0}, filters=filters, precision=precision),
        omnidrones.export_c({"kind": "circle", "radius": 2.0}, precision=precision),
        omnidrones.export_c(env, precision=precision),
        omnidrones.export_c(policies("memory"), precision=precision),
    ]
    for module in modules:
        said = module.check()
        assert "good" in said and "WRONG" not in said
        assert module.precision == precision and f"const {precision} " in module.files[f"{module.name}.h"]
        for function in module.functions:
            assert function.prototype in module.files[f"{module.name}.h"] and function.about and function.stack > 0
            assert 0 < function.operations <= function.operations_at_most
    names = [module.name for module in modules]
    assert names[3:5] == ["hummingbird_indi", "iris_cascade"] and len(set(names)) == len(names)
    assert [module.memory > 0 for module in modules] == [False, False, False, True, True, False, True, True]
    assert modules[-1].tables > 0 and any(own.name.endswith("_step") for own in modules[-1].functions)
    assert "HOVER_HORIZON 50 " in modules[6].files["hover.h"]


@compiled
def test_a_tick_in_c_is_that_of_the_flight_with_its_gains_and_rates(tmp_path):
    gains = omnidrones.Vehicle("hummingbird").gains
    gains["position"] = [1.2 * x for x in gains["position"]]
    how = {"controller": "cascade", "gains": gains, "rates": {"velocity": 50.0, "attitude": 250.0, "rate": 500.0}}
    reference = {"kind": "circle"}
    flight = omnidrones.fly("hummingbird", reference=reference, duration=2.0, **how)
    states = flight.states()
    law = Library(omnidrones.export_c("hummingbird", precision="double", **how), tmp_path)
    curve = Library(omnidrones.export_c(reference, precision="double"), tmp_path)
    plant = Library(omnidrones.export_c("hummingbird", precision="double"), tmp_path)
    x, memory = states[0].copy(), law.memory()
    target, command = np.zeros(18), np.zeros(4)
    curve.library.circle_target.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    for k in range(len(states)):
        assert np.abs(x - states[k]).max() < 1e-9, k
        curve("target", np.array([0.002 * k]), target)
        law("tick", memory, x, target, command)
        plant("step", x, command, x)


@compiled
@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_in_c_acts_as_here_in_flight(kind, policies, tmp_path):
    policy = policies(kind)
    env = environments(policy, 6)
    here = Library(omnidrones.export_c(policy), tmp_path)
    memories = [here.memory() for _ in range(6)]
    policy.reset()
    told, flying = [], np.ones(6, bool)
    for _ in range(40):
        states, goals = env.states(), env.goals()
        wanted = policy(env.observation)
        for k in np.flatnonzero(flying):
            action = np.zeros_like(wanted[k].ravel())
            here("step", memories[k], states[k].astype(np.float32), goals[k].astype(np.float32), action)
            told.append((action, flown_as(kind, wanted[k].ravel())))
        flying &= ~env.step(wanted).terminated
    got, wanted = (np.array(own) for own in zip(*told, strict=True))
    assert len(told) > 100 and wanted.std(0).max() > 1e-3
    # measured: 1.2e-7
    assert np.abs(got - wanted).max() <= (0 if "discrete" in kind else 1e-5)


def test_the_folder_of_a_run_exports_as_its_policy(tmp_path):
    run = omnidrones.train("Hover", folder=tmp_path / "run", horizon=40, evaluate={"envs": 4}, **KINDS["plain"])
    for path in (tmp_path / "run", str(tmp_path / "run"), run.checkpoint):
        assert omnidrones.export_c(path).files == omnidrones.export_c(run.policy).files
        assert omnidrones.export_onnx(path) == omnidrones.export_onnx(run.policy)


def test_files_are_written_and_others_are_left_unless_forced(tmp_path, policies):
    module = omnidrones.export_c("hummingbird", tmp_path / "c", name="mine")
    assert sorted(module.files) == ["mine.c", "mine.h", "mine.md", "mine_test.c"]
    assert all((tmp_path / "c" / name).read_text() == text for name, text in module.files.items())
    assert sorted(path.name for path in module.write(tmp_path / "c")) == sorted(module.files)
    other = {"name": "mine", "precision": "double"}
    again = omnidrones.export_c("hummingbird", tmp_path / "c", **other)
    assert (tmp_path / "c" / "mine.c").read_text() == again.files["mine.c"] != module.files["mine.c"]
    (tmp_path / "c" / "mine.c").write_text("int mine;\n")
    with pytest.raises(ValueError, match="which omnidrones did not write"):
        omnidrones.export_c("hummingbird", tmp_path / "c", **other)
    assert (tmp_path / "c" / "mine.c").read_text() == "int mine;\n"
    omnidrones.export_c("hummingbird", tmp_path / "c", **other, force=True)
    assert (tmp_path / "c" / "mine.c").read_text() == again.files["mine.c"]

    path = tmp_path / "policy.onnx"
    data = omnidrones.export_onnx(policies("plain"), path)
    assert path.read_bytes() == data == omnidrones.export_onnx(policies("plain"), path)
    with pytest.raises(FileExistsError, match="force=True"):
        omnidrones.export_onnx(policies("discrete"), path)
    assert path.read_bytes() == data
    assert omnidrones.export_onnx(policies("discrete"), path, force=True) == path.read_bytes() != data


def test_what_cannot_be_exported_is_refused_with_the_reason(tmp_path, policies):
    env, policy = omnidrones.make("Hover", 2), policies("plain")
    (tmp_path / "file").write_text("x")
    cases = [
        ((3,), {}, TypeError, "what is a int"),
        ((None,), {}, TypeError, "what is a NoneType"),
        ((np.zeros(3),), {}, TypeError, "what is a ndarray"),
        (("hummingbrd",), {}, ValueError, "did you mean 'hummingbird'"),
        (("a\0b",), {}, ValueError, "no vehicle"),
        ((tmp_path / "no.toml",), {}, FileNotFoundError, "no.toml"),
        ((tmp_path / "no_run",), {}, FileNotFoundError, "does not exist"),
        ((tmp_path,), {}, FileNotFoundError, "holds no checkpoint"),
        (({},), {}, ValueError, "kind"),
        (({"kind": "cirle"},), {}, ValueError, "cirle"),
        (({"kind": "circle", "radius": float("nan")},), {}, ValueError, "radius"),
        (("hummingbird",), {"precision": "half"}, ValueError, "Known: float, double"),
        (("hummingbird",), {"precision": 32}, TypeError, "str"),
        (("hummingbird",), {"name": "int_test"}, ValueError, "not _test behind them"),
        (("hummingbird",), {"name": "../x"}, ValueError, "letters"),
        (("hummingbird",), {"name": ""}, ValueError, "letter"),
        (("hummingbird",), {"dt": -1.0}, ValueError, "dt"),
        (("hummingbird",), {"dtt": 1.0}, ValueError, "Did you mean `dt`"),
        (("hummingbird",), {"gains": {}}, TypeError, "controller='cascade'"),
        (("hummingbird",), {"controller": "mpc"}, ValueError, "solver"),
        (("hummingbird",), {"controller": "cascad"}, ValueError, "did you mean 'cascade'"),
        (("payload",), {"controller": "cascade"}, ValueError, "of another make"),
        (("hummingbird",), {"controller": "indi", "filters": [{"kind": "low_pass", "frequency": 80.0}]}, ValueError, "filters"),
        (("hummingbird",), {"controller": "cascade", "filters": 3}, ValueError, "filters"),
        (("hummingbird",), {"controller": "cascade", "rates": {"speed": 3.0}}, ValueError, "speed"),
        (("hummingbird",), {"controller": "cascade", "gains": {"position": [1.0]}}, ValueError, "position"),
        ((env,), {"dt": 0.1}, TypeError, "a VecEnv takes no dt"),
        ((policy,), {"controller": "cascade"}, TypeError, "a policy takes no controller"),
        (({"kind": "circle"},), {"rates": {}}, TypeError, "a reference takes no rates"),
        (("hummingbird", tmp_path / "file"), {}, FileExistsError, "file"),
        (("hummingbird", "/dev/null/x"), {}, OSError, "/dev/null"),
        (("hummingbird", 3), {}, TypeError, "PathLike"),
    ]
    for given, settings, error, words in cases:
        with pytest.raises(error) as raised:
            omnidrones.export_c(*given, **settings)
        assert words in str(raised.value), (given, settings, raised.value)
    for given, settings, error, words in [
        ((env,), {}, TypeError, "policy is a VecEnv"),
        ((lambda x: x,), {}, TypeError, "a Policy or the folder of a run"),
        (("nowhere",), {}, FileNotFoundError, "does not exist"),
        ((policy,), {"agent": 1}, ValueError, "agent is 1"),
        ((policy,), {"agent": -1}, OverflowError, "negative"),
        ((policy, tmp_path / "no" / "x.onnx"), {}, FileNotFoundError, "x.onnx"),
        ((policy, tmp_path), {}, FileExistsError, "another file"),
    ]:
        with pytest.raises(error) as raised:
            omnidrones.export_onnx(*given, **settings)
        assert words in str(raised.value), (given, settings, raised.value)


def test_environments_with_statistics_are_refused_since_their_text_would_lack_them():
    env = omnidrones.make("Hover", 8, observation=[{"kind": "normalise"}], threads=1)
    assert omnidrones.export_c(env).name == "hover"
    env.reset()
    env.step(env.sample(0))
    env.update_normaliser()
    with pytest.raises(ValueError, match="Export the policy"):
        omnidrones.export_c(env)


def test_a_check_tells_what_is_missing_and_what_the_compiler_said(monkeypatch, tmp_path):
    module = omnidrones.export_c("hummingbird")
    monkeypatch.setenv("CC", str(tmp_path / "no-compiler"))
    with pytest.raises(FileNotFoundError, match="no C compiler here: '.*no-compiler'"):
        module.check()
    fake = tmp_path / "cc"
    fake.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\necho "not today" >&2\nexit 1\n')
    fake.chmod(0o755)
    monkeypatch.setenv("CC", str(fake))
    with pytest.raises(ValueError, match="not today"):
        module.check()


@pytest.mark.parametrize("kind", KINDS)
def test_onnxruntime_acts_on_raw_observations_as_the_policy_does_here(kind, policies):
    runtime = pytest.importorskip("onnxruntime")
    policy = policies(kind)
    data = omnidrones.export_onnx(policy)
    session = runtime.InferenceSession(data, providers=["CPUExecutionProvider"])
    n, env, raw = 50, environments(policy, 50), environments(policy, 50, raw=True)
    carried = {own.name: np.zeros((n, own.shape[1]), np.float32) for own in session.get_inputs() if own.name == "memory"}
    assert bool(carried) == ("memory" in kind)
    policy.reset()
    worst, seen = 0.0, []
    for _ in range(40):
        wanted = policy(env.observation)
        shown = np.ascontiguousarray(raw.observation[:, 0])
        action, *rest = session.run(None, {"observation": shown, **carried})
        carried = {"memory": rest[0]} if rest else {}
        if "discrete" in kind:
            assert action.dtype == np.int64 and np.array_equal(action, wanted[:, 0])
        else:
            worst = max(worst, np.abs(action - flown_as(kind, wanted[:, 0])).max())
        seen.append(action)
        env.step(wanted)
        raw.step(wanted)
    # measured: 1.5e-7
    assert worst < 1e-5 and np.std(seen, axis=(0, 1)).max() > 1e-3
    if carried:
        shown = np.zeros((2, shown.shape[1]), np.float32)
        shown[1, 0] = np.nan
        _, after = session.run(None, {"observation": shown, "memory": np.ones((2, carried["memory"].shape[1]), np.float32)})
        assert after[0].any() and not after[1].any()


@pytest.mark.parametrize("kind", KINDS)
def test_onnx_finds_nothing_wrong_and_metadata_name_the_numbers(kind, policies):
    onnx = pytest.importorskip("onnx")
    policy = policies(kind)
    model = onnx.load_from_string(omnidrones.export_onnx(policy))
    onnx.checker.check_model(model, full_check=True)
    onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
    told = {own.key: own.value for own in model.metadata_props}
    assert told["task"] == "Hover" and [own.version for own in model.opset_import] == [17]
    names = [field.name for field in omnidrones.make("Hover", 1, config=policy.config).spec.observation]
    assert all(f'"{name}"' in told["observation"] for name in names)
