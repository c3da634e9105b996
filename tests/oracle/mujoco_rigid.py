"""Accelerations of every vehicle by MuJoCo, for tests/physics/witness.rs.

    pip install mujoco numpy
    cargo test --test dynamics physics -- --ignored --nocapture print_vehicles > vehicles.txt
    python tests/oracle/mujoco_rigid.py vehicles.txt > tests/oracle/mujoco_rigid.json

MuJoCo sums the parts itself: each is a body welded to a free base. A part that bears a rotor's name becomes a body on a
hinge along the rotor's axis, with the rotor's inertia about it, turning at sigma * Omega; what the part has beyond that
stays welded. The hinge's acceleration is prescribed (first-order lag) and the base's follows from MuJoCo's mass matrix
and bias forces. Thrusts are forces at the hubs, reaction torques moments on the base. No line of ours is in it.
"""

import datetime
import json
import sys

import mujoco
import numpy as np

STATES = 50
GRAVITY = 9.81
SEED = 20


def full(j):
    return np.array([[j["xx"], j["xy"], j["xz"]], [j["xy"], j["yy"], j["yz"]], [j["xz"], j["yz"], j["zz"]]])


def numbers(values):
    return " ".join(repr(float(v)) for v in values)


def inertial(mass, tensor):
    # MuJoCo's compiler refuses tensors on the edge of the triangle inequality, as flat bodies have: it compiles
    # tensor + trace * 1, same axes, and main() takes the trace off again
    lifted = tensor + np.trace(tensor) * np.eye(3)
    six = [lifted[0, 0], lifted[1, 1], lifted[2, 2], lifted[0, 1], lifted[0, 2], lifted[1, 2]]
    return f'<inertial pos="0 0 0" mass="{mass!r}" fullinertia="{numbers(six)}"/>'


def model(vehicle):
    bodies = []
    rotors = {r["name"]: r for r in vehicle["rotors"]}
    for part in vehicle["parts"]:
        tensor, at = full(part["inertia"]), numbers(part["position"])
        rotor = rotors.get(part["name"])
        if rotor is None:
            bodies.append(f'<body pos="{at}">{inertial(part["mass"], tensor)}</body>')
            continue
        # the turning share: symmetric about the axis, with the rotor's inertia about it; all of the part's mass
        n = np.array(rotor["axis"])
        across = (np.trace(tensor) - n @ tensor @ n) / 2
        turning = across * np.eye(3) + (rotor["inertia"] - across) * np.outer(n, n)
        rest = tensor - turning
        hinge = f'<joint name="{rotor["name"]}" type="hinge" axis="{numbers(n)}" pos="0 0 0"/>'
        bodies.append(f'<body pos="{at}">{hinge}{inertial(part["mass"], turning)}</body>')
        if np.abs(rest).max() > 1e-9 * np.abs(tensor).max():
            # may be negative, so not a body of its own: bodies_of_base adds it to the airframe
            vehicle.setdefault("rest", []).append(rest)
    return f"""<mujoco><compiler autolimits="true" boundmass="0" boundinertia="0" balanceinertia="false"/>
    <option gravity="0 0 {-GRAVITY}"/><worldbody><body name="base"><freejoint/>
    {bodies_of_base(vehicle, bodies)}</body></worldbody></mujoco>"""


def bodies_of_base(vehicle, bodies):
    # a rest tensor has no mass, hence no arm: it joins the first part, which is not a rotor
    rest = sum(vehicle.pop("rest", []), np.zeros((3, 3)))
    if rest.any():
        first = vehicle["parts"][0]
        tensor = full(first["inertia"]) + rest
        bodies[0] = f'<body pos="{numbers(first["position"])}">{inertial(first["mass"], tensor)}</body>'
    return "\n".join(bodies)


def accelerations(vehicle, m, d, state, action):
    x = np.array(state)
    attitude = x[6:10] / np.linalg.norm(x[6:10])
    d.qpos[:], d.qvel[:] = 0, 0
    d.qpos[:3], d.qpos[3:7] = x[:3], attitude
    d.qvel[:3], d.qvel[3:6] = x[3:6], x[10:13]
    joint, hinges = np.zeros(m.nv), []
    for rotor, speed, a in zip(vehicle["rotors"], x[13:], action):
        at = m.joint(rotor["name"]).dofadr[0]
        target = rotor["max_speed"] * np.sqrt(max((min(max(a, -1), 1) + 1) / 2, 1e-4))
        tau = rotor["time_constant_up"] if speed < target else rotor["time_constant_down"]
        d.qvel[at] = rotor["spin"] * speed
        joint[at] = rotor["spin"] * (target - speed) / tau
        hinges.append(at)
    mujoco.mj_forward(m, d)
    base = m.body("base").id
    applied = np.zeros(m.nv)
    R = d.xmat[base].reshape(3, 3)
    for rotor, speed in zip(vehicle["rotors"], x[13:]):
        thrust = R @ np.array(rotor["axis"]) * rotor["thrust_coefficient"] * speed**2
        hub = d.xpos[base] + R @ np.array(rotor["position"])
        torque = -rotor["spin"] * rotor["moment_per_thrust"] * thrust
        mujoco.mj_applyFT(m, d, thrust, torque, hub, base, applied)
    M = np.zeros((m.nv, m.nv))
    try:
        mujoco.mj_fullM(m, M, d.qM)
    except (TypeError, AttributeError):
        mujoco.mj_fullM(m, d, M)
    right = applied - d.qfrc_bias - M @ joint
    return np.linalg.solve(M[:6, :6], right[:6])


def main():
    text = next(line for line in open(sys.argv[1]) if "VEHICLES [" in line)
    vehicles = json.loads(text[text.index("["):])
    random = np.random.default_rng(SEED)
    cases = []
    for vehicle in vehicles:
        m = mujoco.MjModel.from_xml_string(model(vehicle))
        # principal moments sum to 4 * trace
        m.body_inertia[:] -= m.body_inertia.sum(axis=1, keepdims=True) / 4
        d = mujoco.MjData(m)
        states, out = [], []
        for _ in range(STATES):
            n = len(vehicle["rotors"])
            state = np.concatenate([
                random.uniform(-5, 5, 6), random.normal(size=4), random.uniform(-10, 10, 3),
                [r["max_speed"] * f for r, f in zip(vehicle["rotors"], random.uniform(0.05, 1, n))],
            ]).round(2)
            state = [float(s) for s in state]
            action = [float(a) for a in random.uniform(-1.2, 1.2, n).round(2)]
            states.append([state, action])
            out.append([float(a) for a in accelerations(vehicle, m, d, state, action)])
        cases.append({"vehicle": vehicle, "states": states, "accelerations": out})
    provenance = {
        "tool": "MuJoCo", "version": mujoco.__version__, "numpy": np.__version__, "seed": SEED,
        "script": "tests/oracle/mujoco_rigid.py", "date": datetime.date.today().isoformat(), "tolerance": 1e-12,
    }
    lines = ",\n".join(json.dumps(c, separators=(",", ":")) for c in cases)
    print('{"provenance":' + json.dumps(provenance) + ',\n"cases":[\n' + lines + "\n]}")


main()
