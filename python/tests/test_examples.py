"""Every example runs as it is."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
NEEDS = {
    "apg_torch": ("torch", ["3"]),
    "ppo_torch": ("torch", ["70000"]),
    "sb3_ppo": ("stable_baselines3", ["2000"]),
    "ray_shards": ("ray", []),
    "slalom_task": (None, ["4", "2", "FIGURE"]),
    "payload_task": (None, ["4", "FIGURE"]),
    "pid_margins": (None, ["2", "20", "FIGURE"]),
    "ported_reward": (None, ["2", "4", "2000"]),
}


@pytest.mark.parametrize("name", sorted(path.stem for path in EXAMPLES.glob("*.py")))
def test_an_example_runs(name, tmp_path):
    package, arguments = NEEDS.get(name, (None, []))
    if package is not None and importlib.util.find_spec(package) is None:
        pytest.skip(f"needs {package}")
    arguments = [str(tmp_path / "figure.svg") if own == "FIGURE" else own for own in arguments]
    program = [sys.executable, str(EXAMPLES / f"{name}.py"), *arguments]
    ran = subprocess.run(program, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    figures = list(tmp_path.glob("figure*.svg"))
    assert bool(figures) == any("figure.svg" in own for own in arguments)
    assert all("<svg" in figure.read_text() for figure in figures)


def test_the_recipes_of_the_documents_run(tmp_path):
    text = (EXAMPLES.parent.parent / "docs" / "recipes.md").read_text().replace("runs/", f"{tmp_path}/")
    blocks = [block for block in re.findall(r"```python\n(.*?)```", text, flags=re.S) if ".ray." not in block]
    program = [sys.executable, "-c", "\n".join([*blocks, "assert run.updates == 40 and np.isfinite(by_mass)"])]
    ran = subprocess.run(program, capture_output=True, text=True)
    assert len(blocks) >= 5 and ran.returncode == 0, ran.stderr


def test_the_page_of_tasks_in_python_runs(tmp_path):
    text = (EXAMPLES.parent.parent / "docs" / "python-tasks.md").read_text().replace("runs/", f"{tmp_path}/")
    text = text.replace('"updates": 1000', '"updates": 20')
    blocks = [block for block in re.findall(r"```python\n(.*?)```", text, flags=re.S) if not block.startswith(" ")]
    checks = ["assert run.summary()['lost']['hits'] < 1000 and len(env.spec.info) > 0 and states.shape == (101, 2)"]
    ran = subprocess.run([sys.executable, "-c", "\n".join([*blocks, *checks])], capture_output=True, text=True)
    assert len(blocks) == 5 and ran.returncode == 0, ran.stderr
