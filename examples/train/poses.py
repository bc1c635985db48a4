#!/usr/bin/env python3
"""poses.py - draw random poses of a humanoid skeleton and write them as an animation

shows     where most of the training poses come from: joint ranges -> rotations -> a motion GLB
run       python3 poses.py --ranges rom_ranges.json --skeleton any_motion.glb --count 400 --seed 1 --out rom_1.glb
          python3 poses.py --clips walk.glb wave.glb --skeleton walk.glb --count 400 --seed 2 --out mix_2.glb
flow      ranges (JSON) + rest skeleton (GLB) --sample, reject crossings--> rotations (frames, joints) --> GLB
          or motion clips --each limb from another frame, mirrored or not, scaled, shaken--> the same

The ranges name the left side and the middle; the right side is the mirror image, with its own random angles or, for
a share of --symmetric, with the left side's (squats, jumps, raised arms: what both sides do together is common).
All angles of a pose except the heading are scaled by one factor from --scale, so that mild poses occur too.
A pose whose limbs run through each other or through the trunk (distances between bone segments) is drawn again.
Only numpy is needed. The same seed gives the same file.
"""
import argparse, json, struct
import numpy as np


def read_glb(path):
    raw = open(path, "rb").read()
    if raw[:4] != b"glTF":
        raise SystemExit(f"{path}: not a GLB file")
    n = struct.unpack_from("<I", raw, 12)[0]
    return json.loads(raw[20:20 + n])


def skeleton(path):
    """names without prefix, parents, rest offsets (metres) of a GLB whose rest rotations are identity"""
    g = read_glb(path)
    nodes, parent = g["nodes"], {}
    for i, nd in enumerate(g["nodes"]):
        for c in nd.get("children", []):
            parent[c] = i
    if any(np.abs(np.array(nd.get("rotation", [0, 0, 0, 1])) - [0, 0, 0, 1]).max() > 1e-4 for nd in nodes):
        raise SystemExit(f"{path}: rest rotations must be identity")
    keep = [i for i, nd in enumerate(nodes) if "mesh" not in nd and ":" in nd.get("name", "")]
    index = {n: k for k, n in enumerate(keep)}
    names = [nodes[i]["name"] for i in keep]
    par = [index.get(parent.get(i, -1), -1) for i in keep]
    off = np.array([nodes[i].get("translation", [0, 0, 0]) for i in keep], float)
    return names, par, off


def axis_rot(axis, angle):
    """rotation matrix of `angle` radians about a unit axis (T 3.8)"""
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def quaternion(m):
    w = np.sqrt(max(0.0, 1 + m[0, 0] + m[1, 1] + m[2, 2])) / 2
    x = np.copysign(np.sqrt(max(0.0, 1 + m[0, 0] - m[1, 1] - m[2, 2])) / 2, m[2, 1] - m[1, 2])
    y = np.copysign(np.sqrt(max(0.0, 1 - m[0, 0] + m[1, 1] - m[2, 2])) / 2, m[0, 2] - m[2, 0])
    z = np.copysign(np.sqrt(max(0.0, 1 - m[0, 0] - m[1, 1] + m[2, 2])) / 2, m[1, 0] - m[0, 1])
    q = np.array([x, y, z, w])
    return q / np.linalg.norm(q)


def unit(v):
    return v / max(np.linalg.norm(v), 1e-12)


class Body:
    def __init__(self, path):
        self.names, self.parent, self.off = skeleton(path)
        self.short = [n.split(":")[-1] for n in self.names]
        self.id = {n: i for i, n in enumerate(self.short)}
        self.rest = np.zeros_like(self.off)
        for j, p in enumerate(self.parent):
            self.rest[j] = self.off[j] + (self.rest[p] if p >= 0 else 0)

    def axis(self, joint, name):
        """unit axis in the bind pose; x left, y up, z forward, the others from the rest skeleton"""
        if name in "xyz":
            return np.eye(3)["xyz".index(name)]
        side = "Left" if joint.startswith("Left") else "Right"
        at = lambda n: self.rest[self.id[side + n]]
        if name == "bone":
            j = self.id[joint]
            child = next(c for c, p in enumerate(self.parent) if p == j)
            return unit(self.rest[child] - self.rest[j])
        if name == "hinge":
            return unit(np.cross(at("ForeArm") - at("Arm"), at("Hand") - at("ForeArm")))
        along = unit(at("HandMiddle1") - at("Hand"))
        across = at("HandIndex1") - at("HandPinky1")
        palm = unit(np.cross(along, across)) * (1 if side == "Left" else -1)
        return palm if name == "palm" else unit(np.cross(palm, along))

    def world(self, rot):
        R, P = np.zeros((len(rot), 3, 3)), np.zeros_like(self.rest)
        for j, p in enumerate(self.parent):
            R[j] = rot[j] if p < 0 else R[p] @ rot[j]
            P[j] = self.rest[j] if p < 0 else P[p] + R[p] @ self.off[j]
        return P


def segment_distance(a, b, c, d, n=9):
    t = np.linspace(0, 1, n)[:, None]
    p, q = a + (b - a) * t, c + (d - c) * t
    return np.sqrt(((p[:, None] - q[None]) ** 2).sum(-1)).min()


def clip_vectors(body, path):
    """rotation vectors (frames, joints, 3) of a clip; joints it does not move stay at zero"""
    raw, g = open(path, "rb").read(), read_glb(path)
    start = 28 + struct.unpack_from("<I", raw, 12)[0]
    anim, out = g["animations"][0], None
    for ch in anim["channels"]:
        joint = body.id.get(g["nodes"][ch["target"]["node"]].get("name", "").split(":")[-1])
        if ch["target"]["path"] != "rotation" or joint is None:
            continue
        acc = g["accessors"][anim["samplers"][ch["sampler"]]["output"]]
        at = start + g["bufferViews"][acc["bufferView"]].get("byteOffset", 0) + acc.get("byteOffset", 0)
        q = np.frombuffer(raw, "<f4", 4 * acc["count"], at).reshape(-1, 4).astype(float)
        q = q / np.linalg.norm(q, axis=1, keepdims=True) * np.where(q[:, 3:] < 0, -1, 1)
        sine = np.linalg.norm(q[:, :3], axis=1, keepdims=True)
        out = np.zeros((len(q), len(body.names), 3)) if out is None else out
        out[:, joint] = q[:, :3] / np.maximum(sine, 1e-9) * 2 * np.arctan2(sine, q[:, 3:])
    return out


def mix(body, clips, rng, low, high, shake):
    """a pose whose trunk, arms and legs come from five frames of any of the clips"""
    limbs = {"": [], "Arm": [], "Leg": []}
    for name in body.short:
        if "End" not in name and not name.startswith(("Left", "Right")):
            limbs[""].append(name)
        elif name.startswith("Left") and "End" not in name:
            limbs["Leg" if any(k in name for k in ("Leg", "Foot", "Toe")) else "Arm"].append(name)
    while True:
        scale, rot = rng.uniform(low, high), np.tile(np.eye(3), (len(body.names), 1, 1))
        for limb, side in (("", "Left"), ("Arm", "Left"), ("Arm", "Right"), ("Leg", "Left"), ("Leg", "Right")):
            clip = clips[rng.integers(len(clips))]
            frame, other = clip[rng.integers(len(clip))], rng.random() < 0.5  # other: from the other side, mirrored
            for name in limbs[limb]:
                here = name.replace("Left", side)
                there = here if not other else here.replace("Left", "?").replace("Right", "Left").replace("?", "Right")
                v = frame[body.id[there]] * ([1, -1, -1] if other else [1, 1, 1])
                v = v * (1 if name == "Hips" else scale) + rng.normal(0, np.radians(shake), 3) * ("Hand" not in name or name == "LeftHand")
                angle = np.linalg.norm(v)
                rot[body.id[here]] = axis_rot(v / max(angle, 1e-9), angle)
        if not crosses(body, rot):
            return rot


def crosses(body, rot):
    P, i = body.world(rot), body.id
    trunk = [("Hips", "Spine1", .17), ("Spine1", "Spine2", .18), ("Spine2", "Neck", .14), ("Neck", "HeadTop_End", .12)]
    arms = [("LeftForeArm", "LeftHand", .05), ("LeftHand", "LeftHandMiddle3", .04),
            ("RightForeArm", "RightHand", .05), ("RightHand", "RightHandMiddle3", .04)]
    legs = [("LeftUpLeg", "LeftLeg", .08), ("LeftLeg", "LeftFoot", .05), ("LeftFoot", "LeftToeBase", .04),
            ("RightUpLeg", "RightLeg", .08), ("RightLeg", "RightFoot", .05), ("RightFoot", "RightToeBase", .04)]
    pairs = [(a, t) for a in arms for t in trunk + legs]
    pairs += [(a, b) for a in arms[:2] for b in arms[2:]] + [(a, b) for a in legs[:3] for b in legs[3:]]
    for (a, b, r), (c, d, s) in pairs:
        gap = r + s - (0.04 if a.endswith("ForeArm") else 0)
        if a.startswith("LeftUp") and c.startswith("RightUp"):
            gap = 0.09                       # thighs touch at rest
        if segment_distance(P[i[a]], P[i[b]], P[i[c]], P[i[d]]) < gap:
            return True
    return False


def draw(body, ranges, rng, low, high, symmetric):
    while True:
        scale, both, rot = rng.uniform(low, high), rng.random() < symmetric, np.tile(np.eye(3), (len(body.names), 1, 1))
        for joint, terms in ranges.items():
            for target in ([joint, joint.replace("Left", "Right")] if joint.startswith("Left") else [joint]):
                if target not in body.id:
                    continue
                if target == joint or not both:
                    drawn = [rng.uniform(*term["degrees"]) for term in terms]
                R = np.eye(3)
                for term, degrees in zip(terms, drawn):
                    heading = target == "Hips" and term["axis"] == "y"
                    angle = np.radians(degrees) * (1 if heading else scale)
                    axis = body.axis(joint, term["axis"])
                    if target != joint:
                        axis = axis * [1, -1, -1]
                    R = R @ axis_rot(axis, angle)
                rot[body.id[target]] = R
        if not crosses(body, rot):
            return rot


def write_glb(path, body, rots, fps=30):
    joints = [j for j in range(len(body.names)) if np.abs(rots[:, j] - np.eye(3)).max() > 0]
    times = (np.arange(len(rots)) / fps).astype("<f4")
    blobs = [times.tobytes()]
    blobs += [np.array([quaternion(r) for r in rots[:, j]], "<f4").tobytes() for j in joints]
    views, at = [], 0
    for b in blobs:
        views.append({"buffer": 0, "byteOffset": at, "byteLength": len(b)})
        at += len(b)
    acc = [{"bufferView": 0, "componentType": 5126, "count": len(rots), "type": "SCALAR",
            "min": [0.0], "max": [float(times[-1])]}]
    acc += [{"bufferView": k + 1, "componentType": 5126, "count": len(rots), "type": "VEC4"} for k in range(len(joints))]
    nodes = []
    for j, n in enumerate(body.names):
        nd = {"name": n, "translation": [float(x) for x in body.off[j]]}
        kids = [c for c, p in enumerate(body.parent) if p == j]
        nodes.append(nd | ({"children": kids} if kids else {}))
    g = {"asset": {"version": "2.0", "generator": "deformnet poses.py"}, "scene": 0,
         "scenes": [{"nodes": [j for j, p in enumerate(body.parent) if p < 0]}], "nodes": nodes,
         "buffers": [{"byteLength": at}], "bufferViews": views, "accessors": acc,
         "animations": [{"name": "random poses",
                         "samplers": [{"input": 0, "output": k + 1, "interpolation": "STEP"} for k in range(len(joints))],
                         "channels": [{"sampler": k, "target": {"node": j, "path": "rotation"}} for k, j in enumerate(joints)]}]}
    head = json.dumps(g, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    body_ = b"".join(blobs)
    body_ += b"\0" * (-len(body_) % 4)
    with open(path, "wb") as f:
        f.write(struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(body_)))
        f.write(struct.pack("<I4s", len(head), b"JSON") + head + struct.pack("<I4s", len(body_), b"BIN\0") + body_)


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("--ranges", help="joint ranges, JSON")
    ap.add_argument("--clips", nargs="*", default=[], help="motions to recombine instead")
    ap.add_argument("--shake", type=float, default=6, help="degrees of noise on what comes from clips")
    ap.add_argument("--skeleton", required=True, help="a GLB with the skeleton, rest rotations identity")
    ap.add_argument("--count", type=int, default=200)
    ap.add_argument("--scale", type=float, nargs=2, default=(0.45, 1), help="least and largest factor on a pose's angles")
    ap.add_argument("--symmetric", type=float, default=0, help="share of poses that are the same on both sides")
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--out", required=True)
    a = ap.parse_args()
    if bool(a.ranges) == bool(a.clips):
        ap.error("give either --ranges or --clips")
    body, rng = Body(a.skeleton), np.random.default_rng(a.seed)
    if a.clips:
        clips = [clip_vectors(body, c) for c in a.clips]
        rots = np.stack([mix(body, clips, rng, *a.scale, a.shake) for _ in range(a.count)])
    else:
        ranges = json.load(open(a.ranges))["joints"]
        rots = np.stack([draw(body, ranges, rng, *a.scale, a.symmetric) for _ in range(a.count)])
    write_glb(a.out, body, rots)
    print(f"{a.out}: {a.count} poses, seed {a.seed}")


if __name__ == "__main__":
    main()
