"""Rewards of other simulators on our Hover, line by line, learnt by PPO and by gradients: NumPy alone.

python python/examples/ported_reward.py [updates of PPO] [updates of APG] [steps of Stable-Baselines3]

Facts are those of HoverAviary in gym-pybullet-drones (github.com/utiasDSL/gym-pybullet-drones, gym_pybullet_drones/envs/HoverAviary.py)
and of the quadcopter in Isaac Lab (github.com/isaac-sim/IsaacLab, isaaclab_tasks/direct/quadcopter/quadcopter_env.py).

By default, seed 0, of 1024 unseen starts: by the aviary's reward PPO ends 0.11 m from the point and crashes none; gradients of it lose 71 % of
them, as it has no slope far away, and on a loss that has one they lose none and end within 4 mm. By Isaac Lab's PPO loses 1.6 % and ends 64 mm
off, gradients lose 2.2 % and end 66 mm off, those that were lost counted. PPO takes half a minute, gradients a few seconds.
"""

import importlib.util
import sys

import numpy as np

import omnidrones
from omnidrones import functions

ppo = int(sys.argv[1]) if len(sys.argv) > 1 else 200
apg = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
sb3 = int(float(sys.argv[3])) if len(sys.argv) > 3 else 2_000_000

POINT = [0.0, 0.0, 1.0]
# HoverAviary begins on the ground below its point, and does not mind a heading
AVIARY = {"target": POINT, "start_position": [[0.0, 0.0], [0.0, 0.0], [0.1, 0.1]], "start_tilt": 0.0, "min_height": 0.05}


def aviary(view, terms):
    """max(0, 2 - |p_t - p|^4)."""
    d2 = functions.squared_norm(np.asarray(POINT) - view.drone().position)
    terms.term("near", "max(0, 2 - |p_t - p|^4)", 2.0, np.maximum(0.0, 2.0 - d2**2), smoothness="piecewise")


def isaac(view, terms):
    """dt (15 (1 - tanh(d / 0.8)) - 0.05 |v|^2 - 0.01 |w|^2), here with what speed may cost bounded."""
    dt, drone = 0.02, view.drone()
    d = functions.norm(np.asarray([0.0, 0.0, 2.0]) - drone.position)
    terms.term("distance_to_goal", "15 dt (1 - tanh(d / 0.8))", 15.0 * dt, 15.0 * dt * (1.0 - np.tanh(d / 0.8)))
    slow = -0.05 * dt * np.minimum(functions.squared_norm(drone.velocity), 100.0)
    terms.term("lin_vel", "-0.05 dt |v|^2", 0.0, slow, low=-5.0 * dt, smoothness="piecewise")
    still = -0.01 * dt * np.minimum(functions.squared_norm(drone.angular_velocity), 1000.0)
    terms.term("ang_vel", "-0.01 dt |w|^2", 0.0, still, low=-10.0 * dt, smoothness="piecewise")


def slope(view, loss):
    """What gradients follow in place of the aviary's reward, which is flat from 1.2 m on and next to flat within 0.3 m."""
    loss.add("|p_t - p|", functions.smooth_norm(np.asarray(POINT) - view.drone().position, 0.1))
    loss.add("0.02 h_5(v)", 0.02 * functions.pseudo_huber(view.drone().velocity, 5.0))
    loss.add("0.005 h_10(w)", 0.005 * functions.pseudo_huber(view.drone().angular_velocity, 10.0))


def tell(name, figures):
    """A line."""
    print(f"{name}: crashed {figures['crashed']:.1%}, last error {figures['final_error']:.3f} m", flush=True)


runs = [
    ("aviary by PPO", "ppo", ppo, {"reward": aviary} | AVIARY),
    ("aviary by APG", "apg", apg, {"reward": aviary} | AVIARY),
    ("aviary by APG on a loss", "apg", apg, {"reward": aviary, "loss": slope} | AVIARY),
    ("isaac by PPO", "ppo", ppo, {"reward": isaac}),
    ("isaac by APG", "apg", apg, {"reward": isaac}),
]
for name, algorithm, updates, settings in runs:
    run = omnidrones.train("Hover", algorithm=algorithm, seed=0, threads=2, **{algorithm: {"updates": updates}}, **settings)
    tell(f"{name}, {run.seconds:.0f} s", run.evaluation)

if importlib.util.find_spec("stable_baselines3") is not None:
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecNormalize

    env = VecNormalize(omnidrones.sb3.VecEnv("Hover", 256, seed=0, stagger=True, reward=aviary, **AVIARY), gamma=0.985)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=2048, n_epochs=4, gamma=0.985, seed=0, device="cpu")
    model.learn(sb3)

    def policy(observation):
        """For the library's own starts, one agent each."""
        actions = model.predict(env.normalize_obs(observation[:, 0]), deterministic=True)[0]
        return np.ascontiguousarray(actions[:, None], np.float32)

    tell("aviary by Stable-Baselines3's PPO", omnidrones.evaluate(policy, "Hover", reward=aviary, **AVIARY))
