"""Environments where they are wanted."""

from __future__ import annotations

import importlib.util
import os
import re
from pathlib import Path
from typing import Any, Literal, overload

from ._core import DeviceEnv, VecEnv


@overload
def make(
    name: Any, /, num_envs: int | None = None, *, device: Literal["cpu"] | None = None, **settings: Any
) -> VecEnv: ...
@overload
def make(name: Any, /, num_envs: int | None = None, *, device: Any, **settings: Any) -> DeviceEnv: ...
def make(
    name: Any, /, num_envs: int | None = None, *, device: Any = None, **settings: Any
) -> VecEnv | DeviceEnv:
    """Many environments of one task, stepped together: a `VecEnv`, or with `device="cuda"` a `DeviceEnv` on that card.

    Parameters
    ----------
    name : str or Task
        A task, as `omnidrones.tasks()` lists them, or a class of your own.
    num_envs : int, optional
        4096 unless `config` says otherwise.
    device : str or torch.device, optional
        "cuda", "cuda:1": a card of NVIDIA; "emulated": the kernels of a card as C++ on the host, for tests; "cpu" unless given.
    **settings
        `config`, `seed`, `threads` and all settings by name, as `VecEnv` takes them; `ring` on the host alone.
    """
    where = "cpu" if device is None else str(device)  # PyTorch's devices, too
    if where in ("cpu", "cpu:0"):
        return VecEnv(name, num_envs, **settings)
    if not re.fullmatch(r"cuda(:\d+)?|emulated", where):
        raise ValueError(f"no device is called '{where}'. Known: cpu, cuda, cuda:1, emulated.")
    if "ring" in settings:
        raise ValueError("'ring' is of the host: arrays on a device are one set, which each step writes anew. Leave it out.")
    return DeviceEnv(name, num_envs, device=where, **settings)


def name_compiler() -> None:
    """Lets the library know NVIDIA's compiler among Python's packages, where it comes with PyTorch; the loader does not look there."""
    if os.environ.get("OMNIDRONES_NVRTC"):
        return
    spec = importlib.util.find_spec("nvidia")
    for root in (spec and spec.submodule_search_locations) or ():
        for path in sorted(Path(root).glob("*/lib/libnvrtc.so.1[2-9]"), reverse=True):
            os.environ["OMNIDRONES_NVRTC"] = str(path)
            return
