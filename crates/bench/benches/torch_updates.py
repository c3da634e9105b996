"""Gradient steps per second of SAC and DQN in PyTorch, beside which ours are measured.

    pip install torch
    python crates/bench/benches/torch_updates.py
    cargo bench -p omnidrones-bench --bench updates

The same work per step, on one thread or on as many as there are cores and with either of Adam's forms, whichever is fastest: batches of 256 rows drawn from 100 000 (30 numbers seen, 4 done);
SAC with two critics, their target networks, an actor and a temperature, each with Adam; DQN with twelve values (3 of each of 4
numbers), the double target and Huber's loss. Layers are Linear and ELU. The fastest of twelve rounds of 200 steps.
"""

import copy
import math
import os
import time

import torch
from torch import nn

SEEN, DONE, LEVELS, BATCH, KEPT, STEPS, ROUNDS = 30, 4, 3, 256, 100_000, 200, 12


def network(inputs, hidden, outputs):
    widths = [inputs, *hidden]
    layers = [part for a, b in zip(widths, widths[1:]) for part in (nn.Linear(a, b), nn.ELU())]
    return nn.Sequential(*layers, nn.Linear(widths[-1], outputs))


class Kept:
    def __init__(self, discrete):
        self.seen = torch.randn(KEPT, SEEN)
        self.done = torch.randint(LEVELS, (KEPT, DONE)) if discrete else torch.rand(KEPT, DONE) * 2 - 1
        self.reward = torch.rand(KEPT, 1)
        self.discount = torch.full((KEPT, 1), 0.985)

    def draw(self):
        row = torch.randint(KEPT - 1, (BATCH,))
        return self.seen[row], self.done[row], self.reward[row], self.seen[row + 1], self.discount[row]


def follow(target, own, share):
    with torch.no_grad():
        torch._foreach_lerp_(list(target.parameters()), list(own.parameters()), share)


class Sac:
    def __init__(self, hidden, form):
        self.kept = Kept(discrete=False)
        self.actor = network(SEEN, hidden, 2 * DONE)
        self.critics = nn.ModuleList(network(SEEN + DONE, hidden, 1) for _ in range(2))
        self.targets = copy.deepcopy(self.critics)
        self.log_alpha = torch.zeros(1, requires_grad=True)
        make = lambda parameters: torch.optim.Adam(parameters, 1e-3, **form)
        self.of_actor, self.of_critics = make(self.actor.parameters()), make(self.critics.parameters())
        self.of_alpha = torch.optim.Adam([self.log_alpha], 1e-3)

    def draw(self, seen):
        mean, raw = self.actor(seen).chunk(2, -1)
        log_std = -5 + 3.5 * (1 + torch.tanh(raw))
        noise = torch.randn_like(mean)
        u = mean + log_std.exp() * noise
        slope = 2 * (math.log(2) - u - nn.functional.softplus(-2 * u))
        log_prob = (-0.5 * noise**2 - log_std - 0.5 * math.log(2 * math.pi) - slope).sum(-1, keepdim=True)
        return torch.tanh(u), log_prob

    def step(self):
        seen, done, reward, following, discount = self.kept.draw()
        alpha = self.log_alpha.exp().detach()
        with torch.no_grad():
            action, log_prob = self.draw(following)
            x = torch.cat([following, action], -1)
            y = reward + discount * (torch.min(*(q(x) for q in self.targets)) - alpha * log_prob)
        x = torch.cat([seen, done], -1)
        loss = sum(nn.functional.huber_loss(q(x), y, delta=10.0) for q in self.critics)
        self.of_critics.zero_grad()
        loss.backward()
        for q in self.critics:
            nn.utils.clip_grad_norm_(q.parameters(), 10.0)
        self.of_critics.step()
        action, log_prob = self.draw(seen)
        x = torch.cat([seen, action], -1)
        for p in self.critics.parameters():
            p.requires_grad_(False)
        loss = (alpha * log_prob - torch.min(*(q(x) for q in self.critics))).mean()
        self.of_actor.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.actor.parameters(), 10.0)
        self.of_actor.step()
        for p in self.critics.parameters():
            p.requires_grad_(True)
        self.of_alpha.zero_grad()
        (-self.log_alpha.exp() * (log_prob.detach() - DONE).mean()).backward()
        self.of_alpha.step()
        follow(self.targets, self.critics, 0.01)


class Dqn:
    def __init__(self, hidden, form):
        self.kept = Kept(discrete=True)
        self.net = network(SEEN, hidden, DONE * LEVELS)
        self.target = copy.deepcopy(self.net)
        self.adam = torch.optim.Adam(self.net.parameters(), 1e-3, **form)

    def step(self):
        seen, done, reward, following, discount = self.kept.draw()
        values = lambda net, x: net(x).view(-1, DONE, LEVELS)
        with torch.no_grad():
            best = values(self.net, following).argmax(-1, keepdim=True)
            y = reward + discount * values(self.target, following).gather(-1, best).squeeze(-1).mean(-1, keepdim=True)
        q = values(self.net, seen).gather(-1, done.unsqueeze(-1)).squeeze(-1)
        loss = nn.functional.huber_loss(q, y.expand_as(q), delta=10.0)
        self.adam.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.net.parameters(), 10.0)
        self.adam.step()
        follow(self.target, self.net, 0.01)


def rate(learner):
    best = math.inf
    for _ in range(ROUNDS):
        begun = time.perf_counter()
        for _ in range(STEPS):
            learner.step()
        best = min(best, time.perf_counter() - begun)
    return STEPS / best


print(f"{'':<6}{'hidden':>12}{'gradient steps/s':>20}")
for hidden in ([256, 256], [64, 64]):
    for name, kind in (("SAC", Sac), ("DQN", Dqn)):
        best = 0.0
        for threads in {1, os.cpu_count()}:
            torch.set_num_threads(threads)
            best = max(best, *(rate(kind(hidden, form)) for form in ({"foreach": True}, {"fused": True})))
        print(f"{name:<6}{str(hidden):>12}{best:>20.0f}", flush=True)
