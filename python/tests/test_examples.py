"""Every example runs as it is."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"
NEEDS = {"apg_torch": ("torch", ["3"]), "sb3_ppo": ("stable_baselines3", ["2000"]), "ray_shards": ("ray", [])}


@pytest.mark.parametrize("name", sorted(path.stem for path in EXAMPLES.glob("*.py")))
def test_an_example_runs(name):
    package, arguments = NEEDS.get(name, (None, []))
    if package is not None and importlib.util.find_spec(package) is None:
        pytest.skip(f"needs {package}")
    program = [sys.executable, str(EXAMPLES / f"{name}.py"), *arguments]
    ran = subprocess.run(program, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr


def test_the_recipes_of_the_documents_run(tmp_path):
    text = (EXAMPLES.parent.parent / "docs" / "recipes.md").read_text().replace("runs/", f"{tmp_path}/")
    blocks = [block for block in re.findall(r"```python\n(.*?)```", text, flags=re.S) if ".ray." not in block]
    program = [sys.executable, "-c", "\n".join([*blocks, "assert run.updates == 40 and np.isfinite(by_mass)"])]
    ran = subprocess.run(program, capture_output=True, text=True)
    assert len(blocks) >= 5 and ran.returncode == 0, ran.stderr
