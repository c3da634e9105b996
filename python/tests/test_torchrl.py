"""TorchRL: its checker, and a rollout that is the batch's."""

import numpy as np
import pytest
from conftest import Climb

import omnidrones

pytest.importorskip("torchrl")
import torch  # noqa: E402
from torchrl.envs.utils import check_env_specs  # noqa: E402

from omnidrones.torchrl import Env  # noqa: E402


@pytest.mark.parametrize("how", [{}, {"actions": {"kind": "multi_discrete", "levels": 3}}, {"actions": {"kind": "discrete", "levels": 2}}])
def test_its_checker_passes(how):
    check_env_specs(Env("Hover", 4, **how))


def test_a_rollout_resets_what_is_done_and_shows_how_it_ended():
    env = Env("Hover", 3, horizon=20)
    env.set_seed(5)
    rows = env.rollout(50, policy=lambda td: td.set("action", torch.full((3, 4), -0.41)), break_when_any_done=False)
    assert rows.shape == (3, 50)
    done = rows["next", "done"][..., 0]
    assert done.any()
    batch = omnidrones.make("Hover", 3, horizon=20, autoreset="same_step")
    assert np.array_equal(batch.reset(5).reshape(3, -1), rows["observation"][:, 0].numpy())
    actions = np.full((3, 1, 4), -0.41, np.float32)
    for t in range(50):
        step = batch.step(actions)
        over = step.terminated | step.truncated
        assert np.array_equal(over, done[:, t].numpy())
        seen = np.where(over[:, None], batch.final_observation[:, 0], step.observation[:, 0])
        assert np.array_equal(seen, rows["next", "observation"][:, t].numpy())
        if t < 49:
            assert np.array_equal(step.observation[:, 0], rows["observation"][:, t + 1].numpy())


def test_a_class_of_ones_own_passes_its_checker():
    check_env_specs(Env(Climb, 4))
    rows = [env.rollout(5, policy=lambda td: td.set("action", torch.full((3, 4), -0.41))) for env in (Env(Climb, 3, seed=2), Env("Climb", 3, seed=2))]
    assert torch.equal(rows[0]["next", "observation"], rows[1]["next", "observation"])


def test_columns_of_the_information_are_told_by_name():
    env = Env("Hover", 3, horizon=20, columns=("return", "position_error"))
    check_env_specs(env)
    env.set_seed(5)
    rows = env.rollout(30, policy=lambda td: td.set("action", torch.full((3, 4), -0.41)), break_when_any_done=False)
    batch = omnidrones.make("Hover", 3, horizon=20, autoreset="same_step")
    batch.reset(5)
    for t in range(30):
        batch.step(np.full((3, 1, 4), -0.41, np.float32))
        for name in ("return", "position_error"):
            assert np.array_equal(batch.column(name), rows["next", name][:, t, 0].numpy())
    with pytest.raises(ValueError, match="column"):
        Env("Hover", 3, columns=("retrun",))
