#!/usr/bin/env python3
"""make_clip.py - the demo's motion: a loop of squat, knee lift with a twist, and curls that turn the forearm

shows     where examples/demo/clip.glb comes from: keyed joint angles -> a periodic spline -> rotations -> motion GLB
run       python3 make_clip.py --character humanoid.safetensors --out clip.glb
flow      KEYS (degrees, a few a joint) --periodic cubic through the keys--> angles (frames) --axes--> rotations
          WAY (hips, left ankle) --two-bone legs--> hips, knees, ankles: no foot slides --> GLB, 72 frames, 24 a second

Axes are those of ../train/poses.py: x left, y up, z forward in the bind pose, `bone` along the joint's bone, `hinge`
across the elbow, `curl` closes a finger; of several the last acts first. A right joint mirrors its axis (x, -y, -z),
so equal angles left and right are a symmetric pose. Only numpy is needed.
"""
import argparse, json, os, struct, sys
import numpy as np
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "train"))
import poses

FRAMES, FPS = 72, 24

# time 0..12, one loop: stand 0, squat 2.5 with arms forward, arms up 4.6, left knee up and twist 6.5, curls 10.6;
# the hips' and the left ankle's way from rest, metres; how far the knees point outward and the left toes down, degrees
WAY = {
    "hips x": {0: 0, 4.2: 0, 5.2: -.075, 6.5: -.090, 7.6: -.075, 8.8: 0, 10.6: 0},
    "hips y": {0: -.010, 1: -.09, 2.5: -.28, 3.5: -.14, 4.6: -.010, 6.5: -.012, 8.6: -.012, 10.6: -.025},
    "hips z": {0: 0, 1: -.03, 2.5: -.11, 3.5: -.05, 4.6: .01, 6.5: 0, 8.6: 0},
    "ankle x": {0: 0, 4.6: 0, 6.5: -.05, 8.4: 0},
    "ankle y": {0: 0, 4.6: 0, 5.5: .19, 6.5: .31, 7.5: .18, 8.4: 0},
    "ankle z": {0: 0, 4.6: 0, 5.5: .12, 6.5: .24, 7.5: .12, 8.4: 0},
    "knees": {0: 3, 1: 12, 2.5: 24, 4.6: 4, 6.5: 6, 8.6: 3},
    "toes": {0: 0, 4.6: 0, 5.3: 26, 6.5: 22, 7.7: 20, 8.4: 0},
}
# joint: [(axis, {time: degrees})]; "Both" is the left side and its mirror
KEYS = {
    "LeftToeBase": [("x", {0: 0, 4.6: 0, 5.0: -16, 5.8: 0, 8.6: 0})],
    "Hips": [("x", {0: 0, 1: 5, 2.5: 16, 3.5: 9, 4.6: 0, 6.5: -3, 8.6: 0}), ("z", {0: 0, 4.6: 0, 6.5: -5, 8.6: 0})],
    "Spine": [("y", {0: 0, 2.5: 0, 4.6: 0, 6.5: 10, 8.6: -2, 10.6: -4}),
              ("x", {0: 0, 2.5: 5, 4.6: -3, 6.5: 2, 8.6: 0})],
    "Spine1": [("y", {0: 0, 2.5: 0, 4.6: 0, 6.5: 12, 8.6: -2, 10.6: -6}),
               ("x", {0: 0, 2.5: 5, 4.6: -4, 6.5: 3, 8.6: 0})],
    "Spine2": [("y", {0: 0, 2.5: 0, 4.6: 0, 6.5: 12, 8.6: -2, 10.6: -6}),
               ("x", {0: 0, 2.5: 2, 4.6: -4, 6.5: 2, 8.6: 0})],
    "Neck": [("y", {0: 0, 4.6: 0, 6.5: -8, 8.6: 2, 10.5: 6}), ("x", {0: 0, 2.5: -12, 4.6: 4, 8.6: 0})],
    "Head": [("y", {0: 0, 4.6: 0, 6.5: -10, 8.6: 2, 10.5: 8}), ("x", {0: 0, 2.5: -12, 4.6: 2, 8.6: 0})],
    "BothShoulder": [("z", {0: 0, 2.5: 2, 4.6: 16, 6.5: 8, 8.6: 0, 10.5: 0}), ("y", {0: 0, 2.5: -8, 4.6: 0, 6.5: 0})],
    "BothArm": [("y", {0: 0, 1: -34, 2.5: -72, 3.5: -44, 4.6: -12, 6.5: -30, 8.6: -8, 10.5: 0}),
                ("z", {0: 0, 1: 16, 2.5: 50, 3.5: 68, 4.6: 92, 6.5: 52, 7.6: 18, 8.6: -14, 10.5: -20}),
                ("bone", {0: 0, 2.5: 0, 4.6: -15, 6.5: 20, 8.6: 5, 10.5: 0})],
    "BothForeArm": [("hinge", {0: 0, 1: -8, 2.5: -18, 4.6: 8, 5.5: 34, 6.5: 58, 7.6: 36, 8.6: 20, 9.6: 58, 10.6: 82,
                               11.4: 42}),
                    ("bone", {0: 0, 1.2: 25, 2.5: 50, 4.6: 0, 6.5: -35, 8.6: 45, 9.6: 10, 10.6: -60, 11.4: -25})],
    "BothHand": [("lateral", {0: 0, 2.5: -18, 4.6: 10, 6.5: 12, 8.6: -10, 10.6: 24})],
    "RightArm": [("y", {0: 0, 4.6: 0, 6.5: -26, 8.6: 0})],
    "Fingers": [("curl", {0: 4, 2.5: -4, 4.6: 0, 6.5: 26, 8.6: 10, 10.6: 42})],
    "Thumbs": [("curl", {0: 0, 2.5: -4, 6.5: 8, 8.6: 4, 10.6: 20})],
}


class Skeleton(poses.Body):
    """a poses.Body read from a character's safetensors instead of a GLB"""

    def __init__(self, path):
        raw = open(path, "rb").read()
        n = struct.unpack_from("<Q", raw)[0]
        head = json.loads(raw[8:8 + n])
        get = lambda k, t: np.frombuffer(raw, t, offset=8 + n + head[k]["data_offsets"][0],
                                         count=int(np.prod(head[k]["shape"]))).reshape(head[k]["shape"])
        self.names = head["__metadata__"]["joint_names"].split(",")
        self.parent = [int(x) for x in get("parents", "<i4")]
        self.rest = get("joint_rest", "<f4").astype(float)
        self.off = np.array([self.rest[j] - (self.rest[p] if p >= 0 else 0) for j, p in enumerate(self.parent)])
        self.short = [n.split(":")[-1] for n in self.names]
        self.id = {n: i for i, n in enumerate(self.short)}


def spline(keys, t, period):
    """cubic through the keys, periodic, slopes limited so that no key is overshot (Fritsch and Carlson 1980)"""
    x = np.array(sorted(keys))
    y = np.array([keys[k] for k in x], float)
    h = np.diff(np.append(x, x[0] + period))
    d = (np.roll(y, -1) - y) / h                       # secant from key i to i + 1
    before = np.roll(d, 1)
    w1, w2 = 2 * h + np.roll(h, 1), h + 2 * np.roll(h, 1)
    flat = before * d <= 0
    m = np.where(flat, 0, (w1 + w2) / np.where(flat, 1, w1 / np.where(flat, 1, before) + w2 / np.where(flat, 1, d)))
    out = np.empty(len(t))
    for n, s in enumerate(np.mod(t - x[0], period) + x[0]):
        i = int(np.searchsorted(x, s, "right")) - 1
        j = (i + 1) % len(x)
        u = (s - x[i]) / h[i]
        out[n] = ((1 + 2 * u) * (1 - u) ** 2 * y[i] + u * (1 - u) ** 2 * h[i] * m[i]
                  + u * u * (3 - 2 * u) * y[j] + u * u * (u - 1) * h[i] * m[j])
    return out


def targets(key):
    """joints a key of the table moves"""
    if key in ("Fingers", "Thumbs"):
        part = ("Index", "Middle", "Ring", "Pinky") if key == "Fingers" else ("Thumb",)
        return [f"{s}Hand{f}{i}" for s in ("Left", "Right") for f in part for i in (1, 2, 3)]
    return [key.replace("Both", s) for s in ("Left", "Right")] if key.startswith("Both") else [key]


def angles(body):
    t = np.arange(FRAMES) * 12 / FRAMES
    rot = np.tile(np.eye(3), (FRAMES, len(body.names), 1, 1))
    for key, terms in KEYS.items():
        for joint in targets(key):
            j = body.id[joint]
            for axis, keys in terms:
                a = body.axis(joint, axis)
                if joint.startswith("Right") and axis in "xyz":
                    a = a * [1, -1, -1]
                elif joint.startswith("Right"):
                    a = body.axis(joint.replace("Right", "Left"), axis) * [1, -1, -1]
                for f, degrees in enumerate(spline(keys, t, 12)):
                    rot[f, j] = rot[f, j] @ poses.axis_rot(a, np.radians(degrees))
    return rot


def frame(a, b):
    """orthonormal columns: along a, then the part of b across it"""
    a = poses.unit(a)
    b = poses.unit(b - (a @ b) * a)
    return np.stack([a, b, np.cross(a, b)], 1)


def plant(body, rot):
    """turns hips, knees and ankles so that both ankles are where WAY puts them; returns the hips' travel (frames,3).
    The knee bends until hip and ankle are as far apart as they must be; then the leg turns as a whole, its hinge
    pointing outward by "knees"; then the foot turns back to the ground"""
    t = np.arange(FRAMES) * 12 / FRAMES
    way = {k: spline(v, t, 12) for k, v in WAY.items()}
    move = np.stack([way["hips " + c] for c in "xyz"], 1)
    for f in range(FRAMES):
        hips = rot[f, body.id["Hips"]]
        for side, s in (("Left", 1), ("Right", -1)):
            up, knee, foot = (body.id[side + n] for n in ("UpLeg", "Leg", "Foot"))
            hip = body.rest[0] + move[f] + hips @ body.off[up]
            ankle = body.rest[foot] + (np.array([way["ankle " + c][f] for c in "xyz"]) if s > 0 else 0)
            leg = lambda bend: body.off[knee] + poses.axis_rot((1, 0, 0), bend) @ body.off[foot]
            lo, hi = 0.0, 2.6                                      # the leg gets shorter as the knee bends: bisect
            for _ in range(50):
                bend = (lo + hi) / 2
                lo, hi = (bend, hi) if np.linalg.norm(leg(bend)) > np.linalg.norm(ankle - hip) else (lo, bend)
            out = np.radians(way["knees"][f]) * s
            hinge = np.array((np.cos(out), 0, -np.sin(out)))
            whole = frame(ankle - hip, hinge) @ frame(leg(bend), np.array((1.0, 0, 0))).T
            bent = poses.axis_rot((1, 0, 0), bend)
            rot[f, up], rot[f, knee] = hips.T @ whole, bent
            rot[f, foot] = (whole @ bent).T @ poses.axis_rot((1, 0, 0), np.radians(way["toes"][f]) if s > 0 else 0.0)
    return move


def write(path, body, rot, move):
    """poses.write_glb with a translation channel for the hips, linear keys and a name of its own"""
    joints = [j for j in range(len(body.names)) if np.abs(rot[:, j] - np.eye(3)).max() > 0]
    quats = []
    for j in joints:
        q = np.array([poses.quaternion(r) for r in rot[:, j]])
        for f in range(1, len(q)):
            if q[f] @ q[f - 1] < 0:
                q[f] = -q[f]
        quats.append(q)
    times = (np.arange(len(rot)) / FPS).astype("<f4")
    data = [times] + [q.astype("<f4") for q in quats] + [(move + body.off[0]).astype("<f4")]
    kinds = ["SCALAR"] + ["VEC4"] * len(quats) + ["VEC3"]
    views, at = [], 0
    for a in data:
        views.append({"buffer": 0, "byteOffset": at, "byteLength": a.nbytes})
        at += a.nbytes
    acc = [{"bufferView": i, "componentType": 5126, "count": len(rot), "type": k} for i, k in enumerate(kinds)]
    acc[0] |= {"min": [float(times[0])], "max": [float(times[-1])]}
    nodes = []
    for j, name in enumerate(body.names):
        kids = [c for c, p in enumerate(body.parent) if p == j]
        node = {"name": name, "translation": [float(x) for x in body.off[j]]}
        nodes.append(node | ({"children": kids} if kids else {}))
    channels = [(j, "rotation") for j in joints] + [(0, "translation")]
    g = {"asset": {"version": "2.0", "generator": "deformnet make_clip.py", "copyright": "CC0"}, "scene": 0,
         "scenes": [{"nodes": [0]}], "nodes": nodes, "buffers": [{"byteLength": at}], "bufferViews": views,
         "accessors": acc, "animations": [{
             "name": "exercise",
             "samplers": [{"input": 0, "output": k + 1, "interpolation": "LINEAR"} for k in range(len(channels))],
             "channels": [{"sampler": k, "target": {"node": j, "path": p}} for k, (j, p) in enumerate(channels)]}]}
    head = json.dumps(g, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    blob = b"".join(a.tobytes() for a in data)
    with open(path, "wb") as f:
        f.write(struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(blob)))
        f.write(struct.pack("<I4s", len(head), b"JSON") + head + struct.pack("<I4s", len(blob), b"BIN\0") + blob)


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("--character", required=True, help="humanoid.safetensors")
    ap.add_argument("--out", required=True, help="motion, GLB")
    a = ap.parse_args()
    body = Skeleton(a.character)
    rot = angles(body)
    move = plant(body, rot)
    crossing = [f for f in range(FRAMES) if poses.crosses(body, rot[f])]
    write(a.out, body, rot, move)
    print(f"{a.out}: {FRAMES} frames at {FPS}, hips travel {np.ptp(move[:, 1]):.2f} m up and down; "
          f"frames in which limbs run through the body: {crossing if crossing else 'none'}")


if __name__ == "__main__":
    main()
