#!/usr/bin/env python3
"""evaluate.py - how far from the truth is each way to deform a character? (the table of T 3.3 and 3.4)

run       python3 evaluate.py --characters DIR --truth DIR [--only a,b] [--motions jumping] [--json R.json]
                              name=model.safetensors ...
          for example MLP=mlp.safetensors GAT=gat.safetensors MultiResGNet=humanoid.safetensors
shows     LBS and DQS by deformnet.h; Delta Mush and LBS with twist bones, the rivals a game has, written plainly below;
          each model as it runs in a game: dn_rig_create and dn_deform
figures   distance of every vertex to the truth over all settled frames, cm: mean, 99th percentile, largest; mean and 99th
          percentile as shares of LBS's; rest: share of the vertices LBS places within 0.5 mm that stay within 0.5 mm;
          worse: frames whose mean is worse than LBS's
"""
import argparse
import glob
import json
import os

import numpy as np

import dn
import safetensors_io as st

RESTING = 0.0005


# ------------------------------------------------------------------------------------------------ rivals
class DeltaMush:
    """Mancewicz et al. 2014: smooth the skinned mesh, then add back the detail that smoothing takes from the rest mesh"""

    def __init__(self, c, passes=20, step=0.5):
        self.c, self.passes, self.step = c, passes, step
        self.degree = np.maximum(1, np.diff(c.first)).astype(np.float32)[:, None]
        self.alone = np.diff(c.first) == 0
        self.starts = np.minimum(c.first[:-1], max(0, len(c.next) - 1)).astype(np.int64)
        smooth = self.smooth(c.rest)
        self.detail = np.einsum("nij,nj->ni", self.frames(smooth), c.rest - smooth)
        self.skin = dn.Deformer(c)

    def smooth(self, p):
        for _ in range(self.passes):
            mean = np.add.reduceat(p[self.c.next], self.starts, axis=0) / self.degree
            p = np.where(self.alone[:, None], p, p + self.step * (mean - p))
        return p

    def frames(self, p):
        """rows: normal, the edge to the first neighbour made orthogonal to it, their cross product (N,3,3)"""
        t = p[self.c.triangle]
        face = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
        n = np.zeros_like(p)
        for k in range(3):
            for axis in range(3):
                n[:, axis] += np.bincount(self.c.triangle[:, k], face[:, axis], len(p)).astype(np.float32)
        unit = lambda v: v / np.maximum(1e-12, np.linalg.norm(v, axis=1, keepdims=True))
        n, edge = unit(n), p[self.c.next[self.starts]] - p
        tangent = unit(edge - (edge * n).sum(1, keepdims=True) * n)
        return np.stack([n, tangent, np.cross(n, tangent)], 1)

    def __call__(self, palette):
        skinned = self.skin(palette)
        coarse = skinned[self.c.first_vertex]
        smooth = self.smooth(coarse)
        moved = smooth + np.einsum("nij,ni->nj", self.frames(smooth), self.detail) - coarse
        return skinned + moved[self.c.node_of_vertex]


class TwistBones:
    """LBS in which twist runs evenly along a limb, as a rig with many twist bones gives it: forearm and shin turn with
    the hand and foot, the upper arm and thigh are turned back towards the shoulder and hip"""
    LIMBS = [("ForeArm", "Hand", True), ("Arm", "ForeArm", False), ("UpLeg", "Leg", False), ("Leg", "Foot", True)]

    def __init__(self, c):
        self.c, self.parts = c, []
        index = {n: k for k, n in enumerate(c.joint_names)}
        for side in ("Left", "Right"):
            for name, child, follows in self.LIMBS:
                if side + name in index and side + child in index:
                    j, k = index[side + name], index[side + child]
                    a = c.joint_positions[k] - c.joint_positions[j]
                    along = ((c.positions - c.joint_positions[j]) @ a / (a @ a)).clip(0, 1)
                    self.parts.append((j, k if follows else j, a / np.linalg.norm(a), along if follows else along - 1))

    @staticmethod
    def twist(r, axis):
        """angle of rotation r about the axis, by swing and twist"""
        w = np.sqrt(max(0.0, 1 + np.trace(r))) / 2
        v = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
        if w < 1e-3:  # a half turn: its sign is arbitrary
            return 0.0
        return 2 * np.arctan2(v @ axis / (4 * w), w)

    def __call__(self, palette):
        c, turned = self.c, {}
        for j, moving, axis, share in self.parts:
            r = palette[c.parents[moving]][:, :3].T @ palette[moving][:, :3]
            angle = (self.twist(r, axis) * share)[:, None]
            p = c.positions - c.joint_positions[j]
            p = p * np.cos(angle) + np.cross(axis, p) * np.sin(angle) + axis * (p @ axis)[:, None] * (1 - np.cos(angle))
            turned[j] = (p + c.joint_positions[j]) @ palette[j][:, :3].T + palette[j][:, 3]
        out = np.zeros_like(c.positions)
        for k in range(c.skin_joint.shape[1]):
            joint, weight = c.skin_joint[:, k], c.skin_weight[:, k:k + 1]
            m = palette[joint]
            p = np.einsum("vij,vj->vi", m[:, :, :3], c.positions) + m[:, :, 3]
            for j, q in turned.items():
                p = np.where((joint == j)[:, None], q, p)
            out += weight * p
        return out


# ------------------------------------------------------------------------------------------------ the table
class Figures:
    """distances of all frames of a method, kept as float32"""

    def __init__(self):
        self.parts, self.kept, self.resting, self.worse, self.frames = [], 0, 0, 0, 0

    def add(self, error, plain):
        rest = plain < RESTING
        self.parts.append(error.astype(np.float32))
        self.kept += int((error[rest] < RESTING).sum())
        self.resting += int(rest.sum())
        self.worse += int(error.mean() > plain.mean() * 1.0001)
        self.frames += 1

    def line(self):
        e = np.concatenate(self.parts)
        return {"mean_cm": 100 * float(e.mean()), "p99_cm": 100 * float(np.percentile(e, 99)), "max_cm": 100 * float(e.max()),
                "rest_kept": self.kept / max(1, self.resting), "frames_worse": self.worse, "frames": self.frames}


def main():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    p.add_argument("--characters", required=True)
    p.add_argument("--truth", required=True)
    p.add_argument("--only", default="", help="comma separated characters, default all")
    p.add_argument("--motions", default="", help="comma separated motions, default all")
    p.add_argument("--step", type=int, default=1, help="every n-th settled frame")
    p.add_argument("--cache", default="", help="folder for geodesic distances, default: next to the truth")
    p.add_argument("--json", default="")
    p.add_argument("models", nargs="*", metavar="name=model.safetensors")
    o = p.parse_args()
    models = [m.split("=", 1) if "=" in m else (os.path.basename(m), m) for m in o.models]
    totals, per_clip, left_out, bound = {}, {}, 0, {}
    for path in sorted(glob.glob(os.path.join(o.truth, "*__*.safetensors"))):
        name, motion = os.path.basename(path)[:-len(".safetensors")].split("__", 1)
        if o.only and name not in o.only.split(",") or o.motions and motion not in o.motions.split(","):
            continue
        if name not in bound:
            c = dn.Character(os.path.join(o.characters, name + ".glb"), cache=o.cache or os.path.join(o.truth, "cache"))
            bound = {name: {"LBS": dn.Deformer(c), "DQS": dn.Deformer(c, dqs=True), "Delta Mush": DeltaMush(c),
                            "LBS, twist bones": TwistBones(c)} | {n: dn.Deformer(c, m) for n, m in models}}
        truth, _ = st.load(path)
        settled = np.asarray(truth.get("settled", np.ones(len(truth["vertices"])))) != 0
        left_out += int((~settled).sum())
        clip = {}
        for f in np.flatnonzero(settled)[::o.step]:
            palette, want = np.array(truth["palettes"][f], np.float32), truth["vertices"][f]
            error = {n: np.linalg.norm(run(palette) - want, axis=1) for n, run in bound[name].items()}
            for n, e in error.items():
                totals.setdefault(n, Figures()).add(e, error["LBS"])
                clip.setdefault(n, Figures()).add(e, error["LBS"])
        if clip:
            per_clip[f"{name}, {motion}"] = {n: f.line() for n, f in clip.items()}
    if not totals:
        raise SystemExit("no truth found")
    lines = {n: f.line() for n, f in totals.items()}
    plain = lines["LBS"]
    print(f"{plain['frames']} frames of {len(per_clip)} clips, {left_out} unsettled left out")
    print(f"{'':18} {'mean cm':>8} {'99 % cm':>8} {'max cm':>7} {'mean':>6} {'99 %':>6} {'rest':>7} {'worse':>6}")
    for n, v in lines.items():
        print(f"{n:18} {v['mean_cm']:8.3f} {v['p99_cm']:8.2f} {v['max_cm']:7.1f} {v['mean_cm'] / plain['mean_cm']:6.3f} "
              f"{v['p99_cm'] / plain['p99_cm']:6.3f} {v['rest_kept']:7.1%} {v['frames_worse']:6}")
    if models:
        n = models[-1][0]
        print(f"\n{n} by clip: share of LBS, mean and 99 %")
        for clip, v in per_clip.items():
            print(f"   {clip:44} {v[n]['mean_cm'] / v['LBS']['mean_cm']:6.3f} {v[n]['p99_cm'] / v['LBS']['p99_cm']:6.3f}")
    if o.json:
        json.dump({"all": lines, "clips": per_clip, "unsettled": left_out}, open(o.json, "w"), indent=1)


if __name__ == "__main__":
    main()
