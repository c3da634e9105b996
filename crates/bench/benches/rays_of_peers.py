"""Depth images and scans per second of MuJoCo, Embree and PyBullet in the scenes of rays.rs, which calls this.

    pip install numpy mujoco pybullet embreex
    taskset -c 0 cargo bench -p omnidrones-bench --bench rays -- python

One JSON line per scene, kind and peer: how many a second (the fastest of some repeats, in processor time), and the share
of distances that are ours within 1 cm. MuJoCo casts rays at the exact capsules and boxes (`mj_multiRay`), PyBullet too
(`rayTestBatch`), or it renders (`getCameraImage`, TinyRenderer, at other points of its pixels); Embree casts single rays
at triangles, of which a capsule has about a hundred. Whatever they can share between the rays of an eye they do.
Distances are along the direction, whose forward part is 1 in an image.
"""

import json
import sys
import time

import numpy as np

REPEATS = 3
AROUND, ALONG = 12, 3


def matrix(q):
    w, x, y, z = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


class MuJoCo:
    name = "MuJoCo {}, mj_multiRay"

    def __init__(self, scene):
        import mujoco

        self.mj, self.name = mujoco, self.name.format(mujoco.__version__)
        text = lambda numbers: " ".join(map(str, numbers))
        geoms = ['<geom type="plane" size="100 100 1"/>']
        for (a, b), radius in scene["capsules"]:
            geoms.append(f'<geom type="capsule" fromto="{text(a + b)}" size="{radius}"/>')
        for at, q, size in scene["boxes"]:
            geoms.append(f'<geom type="box" pos="{text(at)}" quat="{text(q)}" size="{text([s / 2 for s in size])}"/>')
        self.model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>")
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    def look(self, eye, directions, farthest):
        n = len(directions)
        ids, distances = np.empty(n, np.int32), np.empty(n)
        # distances of directions of any length are multiples of them
        cutoff = farthest * np.linalg.norm(directions, axis=1).max()
        rays = directions.ravel()
        self.mj.mj_multiRay(self.model, self.data, eye, rays, None, 1, -1, ids, distances, None, n, cutoff)
        return np.where(distances < 0, np.inf, distances)


class Embree:
    name = "Embree 4 (embreex {})"

    def __init__(self, scene):
        from importlib.metadata import version

        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self.name = self.name.format(version("embreex"))
        corners, faces = [], []
        for (a, b), radius in scene["capsules"]:
            self.add(corners, faces, *capsule(np.array(a), np.array(b), radius))
        for at, q, size in scene["boxes"]:
            self.add(corners, faces, *cuboid(np.array(at), matrix(q), np.array(size)))
        square = 100.0 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        self.add(corners, faces, square, [[0, 1, 2], [0, 2, 3]])
        self.scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self.scene, np.array(corners, np.float32), np.array(faces, np.int32))

    @staticmethod
    def add(corners, faces, own_corners, own_faces):
        at = len(corners)
        corners.extend(np.asarray(own_corners).tolist())
        faces.extend([[at + k for k in face] for face in own_faces])

    def look(self, eye, directions, farthest):
        directions = directions.astype(np.float32)
        origins = np.broadcast_to(eye.astype(np.float32), directions.shape).copy()
        return self.scene.run(origins, directions, query="DISTANCE")


class PyBullet:
    name = "PyBullet, rayTestBatch"

    def __init__(self, scene):
        import pybullet

        self.p = pybullet
        self.client = pybullet.connect(pybullet.DIRECT)
        ground = pybullet.createCollisionShape(pybullet.GEOM_PLANE)
        pybullet.createMultiBody(0, ground)
        for (a, b), radius in scene["capsules"]:
            a, b = np.array(a), np.array(b)
            length = np.linalg.norm(b - a)
            self.body(pybullet.GEOM_CAPSULE, (a + b) / 2, upright_to((b - a) / length), radius=radius, height=length)
        for at, q, size in scene["boxes"]:
            self.body(pybullet.GEOM_BOX, at, q[1:] + q[:1], halfExtents=[s / 2 for s in size])

    def body(self, kind, at, attitude, **shape):
        seen = {"length" if key == "height" else key: value for key, value in shape.items()}
        touched, drawn = self.p.createCollisionShape(kind, **shape), self.p.createVisualShape(kind, **seen)
        self.p.createMultiBody(0, touched, drawn, at, attitude)

    def look(self, eye, directions, farthest):
        n, most = len(directions), self.p.MAX_RAY_INTERSECTION_BATCH_SIZE
        ends = (eye + farthest * directions).tolist()
        hits = []
        for first in range(0, n, most):
            part = ends[first:first + most]
            hits += self.p.rayTestBatch([eye.tolist()] * len(part), part)
        return np.array([hit[2] * farthest if hit[0] >= 0 else np.inf for hit in hits])

    def draw(self, scene, eye, turn):
        """What TinyRenderer draws: planar depth."""
        columns, rows = scene["size"]
        near, aspect = 0.02, columns / rows
        up = 2 * np.degrees(np.arctan(np.tan(scene["field_of_view"] / 2) / aspect))
        view = self.p.computeViewMatrix(eye, eye + turn[:, 0], turn[:, 2])
        projection = self.p.computeProjectionMatrixFOV(up, aspect, near, scene["farthest"][0])
        image = self.p.getCameraImage(columns, rows, view, projection, renderer=self.p.ER_TINY_RENDERER)
        far = scene["farthest"][0]
        return (far * near / (far - (far - near) * np.reshape(image[3], (rows, columns)))).ravel()


def upright_to(axis):
    """The quaternion (x, y, z, w) that turns z into an axis."""
    w = 1 + axis[2]
    q = np.array([-axis[1], axis[0], 0, w])
    return (q / np.linalg.norm(q)).tolist()


def capsule(a, b, radius):
    """Corners and triangles of a surface of revolution about the axis, round at its ends."""
    axis = (b - a) / np.linalg.norm(b - a)
    side = np.cross(axis, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    low = np.linspace(-np.pi / 2, 0, ALONG + 1)
    rings = [(a, t) for t in low[1:]] + [(b, t) for t in -low[:0:-1]]
    turns = 2 * np.pi * np.arange(AROUND) / AROUND
    corners = [a - radius * axis]
    for centre, t in rings:
        out = np.outer(np.cos(turns), side) + np.outer(np.sin(turns), other)
        corners += list(centre + radius * (np.sin(t) * axis + np.cos(t) * out))
    corners.append(b + radius * axis)
    faces = [[0, 1 + (k + 1) % AROUND, 1 + k] for k in range(AROUND)]
    for ring in range(len(rings) - 1):
        at = 1 + ring * AROUND
        for k in range(AROUND):
            i, j = at + k, at + (k + 1) % AROUND
            faces += [[i, j, j + AROUND], [i, j + AROUND, i + AROUND]]
    top, at = len(corners) - 1, 1 + (len(rings) - 1) * AROUND
    return corners, faces + [[at + k, at + (k + 1) % AROUND, top] for k in range(AROUND)]


def cuboid(at, turn, size):
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in faces for t in ([a, b, c], [a, c, d])]
    return at + (0.5 * signs * size) @ turn.T, triangles


def measured(look, eyes):
    """Looks from every eye: the distances, and how many eyes a second of processor time."""
    least = np.inf
    for _ in range(REPEATS):
        begun = time.process_time()
        distances = [look(eye) for eye in eyes]
        least = min(least, time.process_time() - begun)
    return np.array(distances), len(eyes) / least


def main():
    with open(sys.argv[1]) as file:
        scene = json.load(file)
    eyes = [(np.array(at), matrix(q)) for at, q in scene["eyes"]]
    peers = [MuJoCo(scene), Embree(scene), PyBullet(scene)]
    for k, what in enumerate(["image", "scan"]):
        directions, farthest = np.array(scene["directions"][k]), scene["farthest"][k]
        ours = np.array(scene["distances"][k]).reshape(len(eyes), -1)
        turned = [np.ascontiguousarray(directions @ turn.T) for _, turn in eyes]
        runs = [(p.name, lambda i, p=p: p.look(eyes[i][0], turned[i], farthest)) for p in peers]
        if what == "image":
            runs.append(("PyBullet, TinyRenderer", lambda i: peers[-1].draw(scene, *eyes[i])))
        for name, look in runs:
            distances, rate = measured(look, range(len(eyes)))
            agree = float(np.mean(np.abs(np.minimum(distances, farthest) - ours) < 0.01))
            print(json.dumps({"scene": scene["name"], "what": what, "who": name, "per_second": rate, "agree": agree}))


if __name__ == "__main__":
    main()
