"""Accelerations of every model by MuJoCo and by Pinocchio, for tests/tree.

    pip install mujoco pin                     # numpy comes with them; versions used: golden/provenance.json
    cargo test --test dynamics -- --ignored export_models
    python tests/witnesses/make.py target/tmp/models tests/witnesses/golden

Writes NAME.bin per model and provenance.json. How the engines are fed: engines.py. Fails where the two disagree by more
than 1e-12 of the largest acceleration of the state, or kappa eps where that is more: by the condition kappa of the mass
matrix any rounding grows.

A file is little-endian: the eight bytes OMNITREE, then four u32: numbers of physics P, of a state N, of an acceleration
V, of states; then P f64 (`Model.physics`: what the file was made for); then per state N + V + V f64: state, accelerations
by MuJoCo, accelerations by Pinocchio. Order of the numbers: engines.py.
"""

import argparse
import datetime
import json
import pathlib
import platform
import struct
import zlib

import numpy as np

from engines import Model, MuJoCo, Pinocchio

TOLERANCE, EPSILON = 1e-12, np.finfo(float).eps


def gap(a, b):
    """Largest difference over the largest acceleration of the state."""
    return np.abs(a - b).max() / np.abs(b).max()


def main():
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("models", type=pathlib.Path, help="folder of model files NAME.json")
    ask.add_argument("out", type=pathlib.Path)
    ask.add_argument("--states", type=int, default=100)
    ask.add_argument("--seed", type=int, default=7)
    ask.add_argument("--only", nargs="*", help="names of models")
    given = ask.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    gaps = {}
    for path in sorted(given.models.glob("*.json")):
        if given.only and path.stem not in given.only:
            continue
        model = Model(path)
        engines = [MuJoCo(model), Pinocchio(model)]
        random = np.random.default_rng([given.seed, zlib.crc32(model.name.encode())])
        physics = model.physics()
        rows, worst, share = [], 0.0, 0.0
        for _ in range(given.states):
            x = model.draw(random)
            answers = [engine.accelerations(x) for engine in engines]
            apart = gap(*answers)
            worst, share = max(worst, apart), max(share, apart / max(TOLERANCE, engines[1].condition() * EPSILON))
            rows.append(np.concatenate([x, *answers]))
        head = struct.pack("<8s4I", b"OMNITREE", len(physics), model.n_state, model.n_velocity, given.states)
        numbers = np.concatenate([physics, *rows]).astype("<f8")
        (given.out / f"{path.stem}.bin").write_bytes(head + numbers.tobytes())
        gaps[path.stem] = {"gap": float(f"{worst:.2e}"), "share_of_allowed": float(f"{share:.2e}")}
        print(f"{path.stem:32} {model.n_velocity:3} freedoms, MuJoCo against Pinocchio {worst:.2e}, "
              f"{share:.2f} of what is allowed", flush=True)
    if not gaps:
        raise SystemExit(f"no models in {given.models}")
    beyond = {name: g for name, g in gaps.items() if not g["share_of_allowed"] <= 1}
    if beyond:
        raise SystemExit(f"MuJoCo and Pinocchio disagree: {beyond}")
    import mujoco
    import pinocchio

    provenance = {
        "script": "tests/witnesses/make.py", "mujoco": mujoco.__version__, "pinocchio": pinocchio.__version__,
        "numpy": np.__version__, "python": platform.python_version(), "seed": given.seed, "states": given.states,
        "date": datetime.date.today().isoformat(), "tolerance": TOLERANCE, "between_them": gaps,
    }
    before = given.out / "provenance.json"
    if given.only and before.exists():
        provenance["between_them"] = json.loads(before.read_text())["between_them"] | gaps
    before.write_text(json.dumps(provenance, indent=1) + "\n")


if __name__ == "__main__":
    main()
