"""Registers the environments with Gymnasium, whichever of the two packages is imported first.

Gymnasium is not imported for it: it takes ten times as long as we do, and need not be there.
"""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType


class _Finder:
    """Looks for nothing itself; has `omnidrones.gym` imported behind Gymnasium."""

    @classmethod
    def find_spec(cls, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        if name != "gymnasium":
            return None
        sys.meta_path.remove(cls)
        try:
            spec = importlib.util.find_spec(name)
        finally:
            # it may only be asked whether there is one
            sys.meta_path.insert(0, cls)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def then_register(module: ModuleType) -> None:
            if cls in sys.meta_path:
                sys.meta_path.remove(cls)
            execute(module)
            importlib.import_module("omnidrones.gym")

        spec.loader.exec_module = then_register  # type: ignore[method-assign]
        return spec


def register() -> None:
    """Now, or as soon as Gymnasium is imported."""
    if "gymnasium" in sys.modules:
        from . import gym  # noqa: F401
    else:
        sys.meta_path.insert(0, _Finder)


def again() -> None:
    """Ids of tasks that are new since, where Gymnasium is there."""
    if "omnidrones.gym" in sys.modules:
        sys.modules["omnidrones.gym"].register()
