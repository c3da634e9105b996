"""The same forest of bodies in MuJoCo and in Pinocchio, from the JSON of a model (`ModelParts`).

Nothing here is translated from the crate's code: placement, forces and layout are written from its documentation.

State (documented in `Layout`), tree by tree: joint positions body by body, joint velocities body by body, rotor speeds;
a floating root's 13 numbers are position, velocity (world), attitude [w x y z], angular velocity (body).
Accelerations are d/dt of the velocities, body by body: floating v' (world) and w' (body), hinge and slide q'', ball w'
relative to the parent along the child's axes. The engines differ from this as follows:

|            | MuJoCo                    | Pinocchio                                              |
|------------|---------------------------|--------------------------------------------------------|
| quaternion | [w x y z]                 | [x y z w]                                              |
| free joint | v world, w body: the same | v and w in the body's axes: v'world = R (v' + w x v)   |
| ball       | w in the child's axes     | w in the child's axes                                  |

MuJoCo refuses massless moving bodies, so the hinges of a massless body move to the body behind it (several joints on
one body). Pinocchio takes massless bodies as they are; every joint is a single one, none is composite.
Drives and limits are left out; damping and springs act. Drag is off.
"""

import json
import pathlib
from xml.sax.saxutils import quoteattr

import numpy as np

FREEDOMS = {"floating": 6, "ball": 3, "revolute": 1, "prismatic": 1}


def kind(body):
    motion = body["joint"]["motion"]
    return motion if isinstance(motion, str) else next(iter(motion))


def axis(body):
    return np.array(next(iter(body["joint"]["motion"].values())))


def tensor(body):
    j = body["inertia"]
    return np.array([[j["xx"], j["xy"], j["xz"]], [j["xy"], j["yy"], j["yz"]], [j["xz"], j["yz"], j["zz"]]])


def placement(body):
    """Rotation and position of a joint's frame in its parent."""
    return np.array(body["joint"]["rotation"]), np.array(body["joint"]["position"])


def matrix(q):
    w, x, y, z = q
    return np.array([
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ])


def quaternion(r):
    """[w x y z] of a rotation matrix: eigenvector of the largest eigenvalue, exact to rounding for any angle."""
    (a, b, c), (d, e, f), (g, h, i) = r
    k = np.array([
        [a + e + i, h - f, c - g, d - b], [h - f, a - e - i, b + d, c + g],
        [c - g, b + d, e - a - i, f + h], [d - b, c + g, f + h, i - a - e],
    ])
    return np.linalg.eigh(k)[1][:, 3]


def text(values):
    return quoteattr(" ".join(repr(float(v)) for v in values))


class Model:
    """A model file and the places of its numbers."""

    def __init__(self, path):
        self.parts = json.loads(pathlib.Path(path).read_text())
        self.name, self.bodies, self.rotors = (self.parts[k] for k in ("name", "bodies", "rotors"))
        self.place()

    def place(self):
        roots = []
        for i, body in enumerate(self.bodies):
            roots.append(i if body["parent"] is None else roots[body["parent"]])
        self.position, self.velocity, self.freedom = {}, {}, {}
        self.speed = {}
        at = freedom = 0
        for root in sorted(set(roots)):
            members = [i for i, r in enumerate(roots) if r == root]
            for i in members:
                k = kind(self.bodies[i])
                self.position[i] = at
                self.freedom[i] = freedom
                freedom += FREEDOMS[k]
                at += {"floating": 13, "ball": 4}.get(k, 1)
            for i in members:
                if kind(self.bodies[i]) != "floating":
                    self.velocity[i] = at
                    at += FREEDOMS[kind(self.bodies[i])]
            for r, rotor in enumerate(self.rotors):
                if roots[rotor["body"]] == root:
                    self.speed[r] = at
                    at += 1
        self.n_state, self.n_velocity = at, freedom

    def draw(self, random):
        """A state: joints inside their limits, 3 m/s, 3 rad/s, rotors between rest and full speed."""
        x = np.zeros(self.n_state)
        for i, body in enumerate(self.bodies):
            at, k = self.position[i], kind(body)
            q = random.normal(size=4)
            q /= np.linalg.norm(q)
            if k == "floating":
                x[at:at + 3] = random.uniform(-2, 2, 3)
                x[at + 3:at + 6] = random.uniform(-3, 3, 3)
                x[at + 6:at + 10] = q
                x[at + 10:at + 13] = random.uniform(-3, 3, 3)
                continue
            if k == "ball":
                x[at:at + 4] = q
            else:
                reach = np.pi if k == "revolute" else 0.5
                limits = body["joint"]["limits"] or {"lower": -reach, "upper": reach}
                x[at] = random.uniform(limits["lower"], limits["upper"])
            v = self.velocity[i]
            x[v:v + FREEDOMS[k]] = random.uniform(-3, 3, FREEDOMS[k])
        for r, rotor in enumerate(self.rotors):
            x[self.speed[r]] = random.uniform(0, rotor["rotor"]["max_speed"])
        return x

    def wrenches(self, x):
        """Force and moment of the rotors on every body that carries some, about its origin, body axes."""
        out = {}
        for r, mounted in enumerate(self.rotors):
            rotor = mounted["rotor"]
            force = rotor["thrust_coefficient"] * x[self.speed[r]] ** 2 * np.array(rotor["axis"])
            moment = np.cross(rotor["position"], force) - rotor["spin"] * rotor["moment_per_thrust"] * force
            f, m = out.setdefault(mounted["body"], (np.zeros(3), np.zeros(3)))
            f += force
            m += moment
        return out

    def ball_spring(self, i, x):
        """Moment -k sin(angle) along the axis of rotation, child's axes: no engine has this law."""
        q = x[self.position[i]:self.position[i] + 4]
        return -self.bodies[i]["joint"]["stiffness"] * 2 * q[0] * q[1:]

    def physics(self):
        """The numbers that the accelerations depend on: a golden file made with others is out of date."""
        out = [self.parts["gravity"]]
        for b in self.bodies:
            j = b["joint"]
            out.append(-1 if b["parent"] is None else b["parent"])
            out.append(["floating", "revolute", "prismatic", "ball"].index(kind(b)))
            out.extend(axis(b) if FREEDOMS[kind(b)] == 1 else [0, 0, 0])
            out.extend(j["position"])
            out.extend(np.ravel(j["rotation"]))
            out.extend([j["damping"], j["stiffness"], j["rest"], j["armature"], b["mass"], *b["center_of_mass"]])
            out.extend(b["inertia"][k] for k in ("xx", "yy", "zz", "xy", "xz", "yz"))
        for mounted in self.rotors:
            r = mounted["rotor"]
            out.extend([mounted["body"], *r["position"], *r["axis"], r["spin"]])
            out.extend([r["thrust_coefficient"], r["moment_per_thrust"], r["max_speed"]])
        return np.array(out, dtype=float)


class MuJoCo:
    """By `mj_forward` of a generated MJCF."""

    def __init__(self, model, sites=False, **option):
        import mujoco

        self.mujoco, self.model = mujoco, model
        self.xml = self.mjcf(sites, option)
        self.m = mujoco.MjModel.from_xml_string(self.xml)
        for i in self.solid:
            # principal moments of tensor + lift are those of the tensor + lift
            self.m.body_inertia[self.id(i)] -= self.lift(tensor(model.bodies[i]))
        self.d = mujoco.MjData(self.m)
        mujoco.mj_setConst(self.m, self.d)
        self.joints = [self.m.joint(f"j{i}") for i in range(len(model.bodies))]
        self.addresses = [(int(j.qposadr[0]), int(j.dofadr[0])) for j in self.joints]

    def id(self, i):
        return self.m.body(f"b{i}").id

    @staticmethod
    def lift(inertia):
        # the compiler refuses point masses and tensors on the edge of the triangle inequality, as flat bodies have
        return np.trace(inertia) or 1e-3

    def joint(self, i, rotation, position):
        """Joint i on a body whose frame has this rotation and position in the joint's own."""
        body = self.model.bodies[i]
        j, k = body["joint"], kind(body)
        if k == "floating":
            return f'<freejoint name="j{i}"/>'
        out = f'<joint name="j{i}" damping="{j["damping"]!r}" pos={text(-rotation.T @ position)}'
        if k == "ball":
            if not np.array_equal(rotation, np.eye(3)):
                raise ValueError(f"{self.model.name}: a massless body on a ball joint, '{body['name']}'")
            return out + ' type="ball"/>'
        out += f' axis={text(rotation.T @ axis(body))} stiffness="{j["stiffness"]!r}" springref="{j["rest"]!r}"'
        out += f' armature="{j["armature"]!r}"'
        return out + f' type="{"hinge" if k == "revolute" else "slide"}"/>'

    def mjcf(self, sites, option):
        bodies = self.model.bodies
        children = {i: [c for c, b in enumerate(bodies) if b["parent"] == i] for i in [None, *range(len(bodies))]}
        carriers = {r["body"] for r in self.model.rotors}
        massless = {i for i, b in enumerate(bodies) if b["mass"] == 0 and not tensor(b).any()}
        for i in massless:
            if i in carriers or len(children[i]) != 1:
                raise ValueError(f"{self.model.name}: massless '{bodies[i]['name']}' needs one child and no rotors")
        self.solid = [i for i in range(len(bodies)) if i not in massless]
        actuators = []

        def write(i):
            chain = [i]
            while chain[-1] in massless:
                chain += children[chain[-1]]
            rotation, position, joints = np.eye(3), np.zeros(3), []
            for k in reversed(chain):
                joints.insert(0, self.joint(k, rotation, position))
                if kind(bodies[k]) != "floating":
                    r, p = placement(bodies[k])
                    rotation, position = r @ rotation, p + r @ position
            last = chain[-1]
            body = bodies[last]
            lifted = tensor(body) + self.lift(tensor(body)) * np.eye(3)
            six = [lifted[0, 0], lifted[1, 1], lifted[2, 2], lifted[0, 1], lifted[0, 2], lifted[1, 2]]
            lines = [f'<body name="b{last}" pos={text(position)} quat={text(quaternion(rotation))}>', *joints]
            lines.append(f'<inertial pos={text(body["center_of_mass"])} mass="{body["mass"]!r}" fullinertia={text(six)}/>')
            for r, mounted in enumerate(self.model.rotors):
                if sites and mounted["body"] == last:
                    rotor = mounted["rotor"]
                    lines.append(f'<site name="r{r}" pos={text(rotor["position"])}/>')
                    moment = [-rotor["spin"] * rotor["moment_per_thrust"] * a for a in rotor["axis"]]
                    most = rotor["thrust_coefficient"] * rotor["max_speed"] ** 2
                    actuators.append(f'<general site="r{r}" gear={text([*rotor["axis"], *moment])} '
                                     f'ctrllimited="true" ctrlrange={text([0, most])}/>')
            for child in children[last]:
                lines += write(child)
            return lines + ["</body>"]

        world = [line for root in children[None] for line in write(root)]
        options = " ".join(f'{k}="{v}"' for k, v in option.items())
        return "\n".join([
            "<mujoco>",
            '<compiler angle="radian" autolimits="true" boundmass="0" boundinertia="0" balanceinertia="false"/>',
            f'<option gravity="0 0 {-self.model.parts["gravity"]!r}" {options}><flag contact="disable"/></option>',
            "<worldbody>", *world, "</worldbody>", "<actuator>", *actuators, "</actuator>", "</mujoco>",
        ])

    def set(self, x):
        """Positions and velocities of a state."""
        model, d = self.model, self.d
        for i, body in enumerate(model.bodies):
            (q, v), at, k = self.addresses[i], model.position[i], kind(body)
            if k == "floating":
                d.qpos[q:q + 3], d.qpos[q + 3:q + 7] = x[at:at + 3], x[at + 6:at + 10]
                d.qvel[v:v + 3], d.qvel[v + 3:v + 6] = x[at + 3:at + 6], x[at + 10:at + 13]
                continue
            n = 4 if k == "ball" else 1
            d.qpos[q:q + n] = x[at:at + n]
            n, at = FREEDOMS[k], model.velocity[i]
            d.qvel[v:v + n] = x[at:at + n]

    def accelerations(self, x):
        mujoco, model, m, d = self.mujoco, self.model, self.m, self.d
        self.set(x)
        mujoco.mj_kinematics(m, d)
        d.xfrc_applied[:], d.qfrc_applied[:] = 0, 0
        for i, (force, moment) in model.wrenches(x).items():
            # about the centre of mass, world axes
            at, r = self.id(i), d.xmat[self.id(i)].reshape(3, 3)
            d.xfrc_applied[at, :3] = r @ force
            d.xfrc_applied[at, 3:] = r @ (moment - np.cross(model.bodies[i]["center_of_mass"], force))
        out = np.zeros(model.n_velocity)
        for i, body in enumerate(model.bodies):
            if kind(body) == "ball":
                v = self.addresses[i][1]
                d.qfrc_applied[v:v + 3] = model.ball_spring(i, x)
        mujoco.mj_forward(m, d)
        for i, body in enumerate(model.bodies):
            n, v, f = FREEDOMS[kind(body)], self.addresses[i][1], model.freedom[i]
            out[f:f + n] = d.qacc[v:v + n]
        return out


class Pinocchio:
    """By `aba`."""

    def __init__(self, model):
        import pinocchio as pin

        self.pin, self.model = pin, model
        self.m = pin.Model()
        self.m.gravity.linear = np.array([0, 0, -model.parts["gravity"]])
        self.ids = []
        for body in model.bodies:
            k = kind(body)
            frame = pin.SE3.Identity() if k == "floating" else pin.SE3(*placement(body))
            joint = {
                "floating": pin.JointModelFreeFlyer, "ball": pin.JointModelSpherical,
                "revolute": lambda: pin.JointModelRevoluteUnaligned(axis(body)),
                "prismatic": lambda: pin.JointModelPrismaticUnaligned(axis(body)),
            }[k]()
            parent = 0 if body["parent"] is None else self.ids[body["parent"]]
            at = self.m.addJoint(parent, joint, frame, body["joint"]["name"])
            inertia = pin.Inertia(body["mass"], np.array(body["center_of_mass"]), tensor(body))
            self.m.appendBodyToJoint(at, inertia, pin.SE3.Identity())
            self.ids.append(at)
        for i, body in enumerate(model.bodies):
            if FREEDOMS[kind(body)] == 1:
                self.m.armature[self.m.joints[self.ids[i]].idx_v] = body["joint"]["armature"]
        self.d = self.m.createData()

    def accelerations(self, x):
        pin, model = self.pin, self.model
        q, v, tau = np.zeros(self.m.nq), np.zeros(self.m.nv), np.zeros(self.m.nv)
        forces = [pin.Force.Zero() for _ in range(self.m.njoints)]
        for i, (force, moment) in model.wrenches(x).items():
            forces[self.ids[i]] = pin.Force(force, moment)
        for i, body in enumerate(model.bodies):
            joint, at, k = self.m.joints[self.ids[i]], model.position[i], kind(body)
            iq, iv, n, damping = joint.idx_q, joint.idx_v, FREEDOMS[k], body["joint"]["damping"]
            if k == "floating":
                w, *xyz = x[at + 6:at + 10]
                q[iq:iq + 3], q[iq + 3:iq + 7] = x[at:at + 3], [*xyz, w]
                v[iv:iv + 3], v[iv + 3:iv + 6] = matrix(x[at + 6:at + 10]).T @ x[at + 3:at + 6], x[at + 10:at + 13]
                continue
            v[iv:iv + n] = x[model.velocity[i]:model.velocity[i] + n]
            tau[iv:iv + n] = -damping * v[iv:iv + n]
            if k == "ball":
                w, *xyz = x[at:at + 4]
                q[iq:iq + 4] = [*xyz, w]
                tau[iv:iv + n] += model.ball_spring(i, x)
            else:
                q[iq] = x[at]
                tau[iv] -= body["joint"]["stiffness"] * (x[at] - body["joint"]["rest"])
        self.q = q
        a = pin.aba(self.m, self.d, q, v, tau, forces)
        out = np.zeros(model.n_velocity)
        for i, body in enumerate(model.bodies):
            iv, n, f, at = self.m.joints[self.ids[i]].idx_v, FREEDOMS[kind(body)], model.freedom[i], model.position[i]
            out[f:f + n] = a[iv:iv + n]
            if kind(body) == "floating":
                turned = a[iv:iv + 3] + np.cross(v[iv + 3:iv + 6], v[iv:iv + 3])
                out[f:f + 3] = matrix(x[at + 6:at + 10]) @ turned
        return out

    def condition(self):
        """Of the mass matrix, at the state last seen."""
        upper = np.triu(self.pin.crba(self.m, self.d, self.q))
        return np.linalg.cond(upper + np.triu(upper, 1).T)
