"""Capsules of DLPack (https://dmlc.github.io/dlpack/latest/python_spec.html), which are made and read where they are Python's."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

from . import _core

_NAME = b"dltensor"
_api = ctypes.pythonapi
_new = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)(("PyCapsule_New", _api))
_pointer = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(("PyCapsule_GetPointer", _api))
_is_named = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.py_object, ctypes.c_char_p)(("PyCapsule_IsValid", _api))

_made: list[tuple[Any, int]] = []
"""Capsules that may not have been taken yet, and what they hold. Who takes one renames it, and gives back what it held. Capsules without
a destructor never run Python while another library is freeing what it has."""


def capsule_of(address: int) -> Any:
    """A capsule that holds the `DLManagedTensor` at that address."""
    _forget()
    capsule = _new(address, _NAME, None)
    _made.append((capsule, address))
    return capsule


def _forget() -> None:
    """Gives back what nobody took and nobody can take any more."""
    kept = []
    while _made:
        try:
            own = _made.pop()  # by one thread alone
        except IndexError:
            break
        if not _is_named(own[0], _NAME):
            continue  # taken
        if _count(own) > _ALONE:
            kept.append(own)
        else:
            _core._give_back(own[1])
    _made.extend(kept)


def _count(own: tuple[Any, int]) -> int:
    return sys.getrefcount(own[0])


_ALONE = _count((object(), 0))
"""What Python counts of an object that a tuple alone has: its releases differ."""


def address_of(capsule: Any) -> int:
    """The address that a capsule holds; it stays there."""
    held: int = _pointer(capsule, _NAME)
    return held
