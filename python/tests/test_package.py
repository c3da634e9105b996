"""The package as it is installed: stubs, types, documentation."""

import inspect
import subprocess
import sys
from pathlib import Path

import omnidrones

PACKAGE = Path(omnidrones.__file__).parent


def test_everything_public_is_documented():
    missing = []
    for name in omnidrones.__all__:
        thing = getattr(omnidrones, name)
        if name.startswith("__"):
            continue
        if not inspect.getdoc(thing):
            missing.append(name)
        if isinstance(thing, type) and thing.__module__ == "omnidrones":
            members = [m for m in vars(thing) if not m.startswith("_")]
            missing += [f"{name}.{m}" for m in members if not inspect.getdoc(getattr(thing, m))]
    assert missing == []


def test_the_stubs_say_what_the_compiled_module_has():
    ran = subprocess.run(
        [sys.executable, "-m", "mypy.stubtest", "omnidrones._core", "--mypy-config-file", str(PACKAGE.parent.parent / "pyproject.toml")],
        capture_output=True,
        text=True,
        cwd=PACKAGE.parent,
    )
    assert ran.returncode == 0, ran.stdout


def test_the_package_is_typed():
    config = PACKAGE.parent.parent / "pyproject.toml"
    ran = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", str(config), "--cache-dir", "/dev/null"],
        capture_output=True,
        text=True,
        cwd=PACKAGE.parent,
    )
    assert ran.returncode == 0, ran.stdout
