#!/usr/bin/env python3
"""tiny.py - the model of examples/minimal.c: how a tube bends when it keeps its volume

shows     training from end to end on one page: meshes, poses, an exact truth, rows by deformnet.h, a model file
run       python3 tiny.py --out ../models/tiny.safetensors     (two minutes; needs make libdeformnet.so)
truth     between -h and h of the elbow the centre line becomes a circular arc that meets both straight parts tangentially,
          sections stay perpendicular to it, and swell by a smooth bump that makes up for the arc being shorter
model     "neuroskinning" (linear, graph attention, linear layers) with 2 joints, features relative, normal, geodesic
"""
import argparse
import math
import time

import numpy as np
import torch

import dn
import nets
import safetensors_io as st

FEATURES = ["relative", "normal", "geodesic"]
JOINTS = ["lower", "upper"]


class Tube(dn.Character):
    """along y, closed, joint 0 at its lower end and joint 1 at the elbow, half-way up; h: half the blend's length"""

    def __init__(self, radius, length, sides, rings):
        self.path = self.name = "tube"
        self.elbow, self.h = length / 2, length / 4
        turn = 2 * np.pi * np.arange(sides) / sides
        y = np.repeat(np.linspace(0, length, rings), sides)
        wall = np.stack([radius * np.tile(np.cos(turn), rings), y, radius * np.tile(np.sin(turn), rings)], 1)
        self.positions = np.concatenate([wall, [[0, 0, 0], [0, length, 0]]]).astype(np.float32)
        V, tri = len(self.positions), []
        for r in range(rings):
            for s in range(sides):
                a, b = r * sides + s, r * sides + (s + 1) % sides
                tri += [(a, a + sides, b), (b, a + sides, b + sides)] if r + 1 < rings else [(V - 1, b, a)]
                tri += [(V - 2, a, b)] if r == 0 else []
        self.indices = np.array(tri, np.uint32)
        u = np.clip((self.positions[:, 1] - self.elbow) / (2 * self.h) + 0.5, 0, 1)
        upper = u * u * (3 - 2 * u)
        self.skin_joint = np.tile(np.array([[0, 1]], np.uint32), (V, 1))
        self.skin_weight = np.stack([1 - upper, upper], 1).astype(np.float32)
        self.joint_names, self.parents = JOINTS, np.array([-1, 0], np.int32)
        self.joint_positions = np.array([[0, 0, 0], [0, self.elbow, 0]], np.float32)
        self.inverse_bind = np.tile(np.eye(4), (2, 1, 1))
        self.inverse_bind[1, 1, 3] = -self.elbow
        self.bind(JOINTS, 128, None)

    def pose(self, axis, angle):
        """upper part turned about `axis` (unit, perpendicular to y) -> palette (2,12), truth (V,3)"""
        R = rotation(axis, np.array([angle]))[0]
        e = np.array([0, self.elbow, 0])
        palette = np.stack([np.eye(3, 4), np.concatenate([R, (e - R @ e)[:, None]], 1)]).astype(np.float32).reshape(2, 12)
        y, h, q = self.positions[:, 1].astype(float) - self.elbow, self.h, 1.0
        along, side = np.array([0, 1.0, 0]), np.cross(axis, [0, 1.0, 0])
        phi = angle * np.clip((y + h) / (2 * h), 0, 1)
        centre = np.outer(y, along)
        if angle > 1e-6:
            bend = h / math.tan(angle / 2)  # radius of the arc; bend * angle long instead of 2 h
            q = bend * angle / (2 * h)
            arc = bend * (np.outer(np.sin(phi), along) + np.outer(1 - np.cos(phi), side)) - h * along
            centre = np.where((y <= -h)[:, None], centre, np.where((y >= h)[:, None], centre @ R.T, arc))
        # the swelling adds a mean of k/2 to the section's area over the arc: (1 + k/2) q = 1 keeps the volume
        swell = np.where(np.abs(y) < h, (1 + np.cos(np.pi * y / h)) / 2, 0) * 2 * (1 / q - 1)
        section = self.positions * [1, 0, 1] * np.sqrt(1 + swell)[:, None]
        truth = centre + e + np.einsum("vij,vj->vi", rotation(axis, phi), section)
        return palette, np.ascontiguousarray(truth, np.float32)


def rotation(axis, angle):
    """(n) angles about one axis -> (n,3,3), Rodrigues"""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle)[:, None, None] * K + (1 - np.cos(angle))[:, None, None] * (K @ K)


def batch(rng, tubes, count):
    """whole tubes in random bends: rows, graph, target"""
    parts = []
    for _ in range(count):
        tube, turn = tubes[rng.integers(len(tubes))], rng.uniform(0, 2 * np.pi)
        pose = tube.pose(np.array([np.cos(turn), 0, np.sin(turn)]), np.radians(130 * rng.uniform() ** 0.7))
        parts.append(dn.make_batch([dn.Pose(tube, *pose)], FEATURES, True, pool=False, width=tubes[0].width))
    start = np.cumsum([0] + [len(p["rows"]) for p in parts])
    table = np.concatenate([p["table"] + a for p, a in zip(parts, start)]).astype(np.int32)
    tensor = lambda a: torch.from_numpy(np.ascontiguousarray(a))
    graph = nets.Graph(tensor(table), tensor(np.concatenate([p["degree"] for p in parts])), tensor(start))
    return tensor(np.concatenate([p["rows"] for p in parts])), graph, tensor(np.concatenate([p["target"] for p in parts]))


def main():
    o = argparse.ArgumentParser()
    o.add_argument("--out", default="../models/tiny.safetensors")
    o.add_argument("--steps", type=int, default=4000)
    o.add_argument("--seed", type=int, default=1)
    o = o.parse_args()
    rng = np.random.default_rng(o.seed)
    torch.manual_seed(o.seed)
    tubes = [Tube(rng.uniform(0.035, 0.06), rng.uniform(0.5, 0.7), int(rng.integers(14, 29)), int(rng.integers(30, 55)))
             for _ in range(80)]
    held_out = [Tube(0.05, 0.6, 24, 49)]  # the one of minimal.c
    for t in tubes + held_out:  # one width of neighbour table for all
        t.width = max(t.degree for t in tubes + held_out)
    net = nets.create("neuroskinning", dn.row_width(FEATURES, 2), pre=(48, 32), gat=2, K=4, Fe=8, post=(48, 32), bn=False,
                      gat_bn=False)
    rows, _, target = batch(rng, tubes, 40)
    stats = getattr(net, "input")
    stats.mean.copy_(rows.mean(0)), stats.std.copy_(rows.std(0)), net.output.std.fill_(float(target.std()))
    adam = torch.optim.Adam(net.parameters(), lr=4e-3)
    began = time.time()
    for step in range(o.steps):
        for group in adam.param_groups:
            group["lr"] = 4e-3 * 0.5 * (1 + math.cos(math.pi * step / o.steps))
        rows, graph, target = batch(rng, tubes, 4)
        loss = ((net.displacement(rows, graph) - target) / net.output.std).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
        if step % 500 == 0 or step + 1 == o.steps:
            with torch.no_grad():
                rows, graph, target = batch(np.random.default_rng(0), held_out, 20)
                error = (net.displacement(rows, graph) - target).norm(dim=1).mean() * 1000
            print(f"step {step:5d}  loss {float(loss):.5f}  held-out tube: {float(error):.2f} mm, skinned "
                  f"{float(target.norm(dim=1).mean() * 1000):.2f} mm  {time.time() - began:.0f} s", flush=True)
    st.save(o.out, {k: v.numpy() for k, v in net.state_dict().items()}, {
        "deformnet.version": "1", "deformnet.arch": "neuroskinning", "deformnet.features": ",".join(FEATURES),
        "deformnet.frame": "root", "deformnet.pooling": "rest", "deformnet.joints": ",".join(JOINTS),
        "deformnet.unit": "1", "deformnet.licence": "MIT or public domain",
        "deformnet.trained_on": "80 tubes, circular bends up to 130 degrees, constant volume (examples/train/tiny.py)"})
    print(f"wrote {o.out}: {nets.parameters(net)} parameters")


if __name__ == "__main__":
    main()
