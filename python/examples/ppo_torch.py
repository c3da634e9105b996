"""PPO (Schulman et al. 2017) on Hover in PyTorch, whose numbers never leave the card: pip install torch.

python python/examples/ppo_torch.py [steps] [device]     # cuda; cpu unless given
"""

import sys
import time

import torch
from torch import nn

import omnidrones
from omnidrones.torch import TensorEnv, captured

device = sys.argv[2] if len(sys.argv) > 2 else "cpu"
N_ENV, T, BATCHES, N_STEP = (4096, 32, 32, 3e7) if device.startswith("cuda") else (512, 64, 16, 6e6)
n_step, EPOCHS = int(float(sys.argv[1]) if len(sys.argv) > 1 else N_STEP), 4
GAMMA, LAMBDA, CLIP, RATE = 0.985, 0.98, 0.2, 1e-3

torch.manual_seed(0)
torch.set_num_threads(1)
env = TensorEnv(omnidrones.make("Hover", N_ENV, device=device, seed=0, stagger=True))
spec, there = env.spec, env.device
n_seen, n_action = spec.n_observation, spec.n_action


def network(n_out, scale):
    net = nn.Sequential(nn.Linear(n_seen, 64), nn.ELU(), nn.Linear(64, 64), nn.ELU(), nn.Linear(64, n_out))
    with torch.no_grad():
        net[-1].weight.mul_(scale)
    return net.to(there)


actor, critic = network(n_action, 0.1), network(1, 1.0)
with torch.no_grad():  # begin about the command that carries the weight
    actor[-1].bias.copy_(torch.from_numpy(env.env.safe_command))
log_std = nn.Parameter(torch.full((n_action,), -0.5, device=there))
weights = [*actor.parameters(), *critic.parameters(), log_std]
optimiser = torch.optim.Adam(weights, RATE, eps=1e-5)

zeros = lambda *shape: torch.zeros(*shape, device=there)  # noqa: E731
seen, action, chance, value = zeros(T, N_ENV, n_seen), zeros(T, N_ENV, n_action), zeros(T, N_ENV), zeros(T + 1, N_ENV)
reward, terminated, over, end_value = zeros(T, N_ENV), zeros(T, N_ENV), zeros(T, N_ENV), zeros(T, N_ENV)
advantage, mean, square, count = zeros(T, N_ENV), zeros(n_seen), zeros(n_seen) + 1.0, zeros(())


def normalised(observation):
    return ((observation - mean) / (square - mean**2).clamp(1e-4).sqrt()).clamp(-10.0, 10.0)


def log_chance(rows, acted):
    normal = torch.distributions.Normal(actor(rows), log_std.exp(), validate_args=False)
    return normal.log_prob(acted).sum(-1)


@torch.no_grad()
def rollout():
    """T steps of all environments into the buffers, and their advantages (Schulman et al. 2016, eq. 16)."""
    for t in range(T):
        seen[t] = env.observation[:, 0]
        rows = normalised(seen[t])
        action[t] = actor(rows) + log_std.exp() * torch.randn(N_ENV, n_action, device=there)
        chance[t], value[t] = log_chance(rows, action[t]), critic(rows)[:, 0]
        step = env.step(action[t])
        # so that values are of the order of one
        reward[t], terminated[t] = (1.0 - GAMMA) * step.reward[:, 0], step.terminated.float()
        over[t] = (step.terminated | step.truncated).float()
        end_value[t] = critic(normalised(env.final_observation[:, 0]))[:, 0]
    value[T] = critic(normalised(env.observation[:, 0]))[:, 0]
    ahead = zeros(N_ENV)
    for t in reversed(range(T)):
        # an episode that only ran out of time would have gone on
        after = torch.where(over[t] > 0, end_value[t] * (1.0 - terminated[t]), value[t + 1])
        ahead = reward[t] + GAMMA * after - value[t] + GAMMA * LAMBDA * (1.0 - over[t]) * ahead
        advantage[t] = ahead


@torch.no_grad()
def take_statistics():
    """Of all that was seen, for the next rollout."""
    count.add_(1.0)
    mean.lerp_(seen.mean((0, 1)), 1.0 / count)
    square.lerp_((seen**2).mean((0, 1)), 1.0 / count)


def learn(rows, acted, old, gained, target):
    new = log_chance(rows, acted)
    ratio = (new - old).exp()
    gained = (gained - gained.mean()) / (gained.std() + 1e-8)
    gain = torch.minimum(ratio * gained, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * gained).mean()
    optimiser.zero_grad()
    (0.5 * (critic(rows)[:, 0] - target).square().mean() - gain).backward()
    nn.utils.clip_grad_norm_(weights, 1.0)
    optimiser.step()


@torch.no_grad()
def policy(observation):
    """For arrays of the host."""
    rows = normalised(torch.from_numpy(observation).to(there))
    return actor(rows).clamp(-1.0, 1.0).cpu().numpy()


env.reset()
rollout()
take_statistics()
collect = captured(rollout, env)  # on a card one piece of work


def train():
    """One update."""
    collect()
    rows = normalised(seen.reshape(-1, n_seen))
    target = (advantage + value[:T]).reshape(-1)
    flat = (rows, action.reshape(-1, n_action), chance.reshape(-1), advantage.reshape(-1), target)
    for _ in range(EPOCHS):
        for chosen in torch.randperm(N_ENV * T, device=there).chunk(BATCHES):
            learn(*(x[chosen] for x in flat))
    take_statistics()


updates, began = max(1, n_step // (N_ENV * T)), time.perf_counter()
for update in range(updates):
    for group in optimiser.param_groups:
        group["lr"] = RATE * (1.0 - update / updates)
    train()
    if update % 20 == 0:
        print(f"update {update:4}  mean reward {reward.mean().item() / (1.0 - GAMMA):.3f}", flush=True)
taken = time.perf_counter() - began
print(f"{updates * N_ENV * T:,} steps in {taken:.1f} s, {updates * N_ENV * T / taken:,.0f} per second")
print(f"success from unseen starts: {omnidrones.evaluate(policy, 'Hover')['success']:.3f}")
