#!/usr/bin/env python3
"""warp.py - characters of other proportions from a character: long legs, short arms, a big head, thick limbs

shows     how a few characters become many for training: a network that has met other proportions, joints placed by another
          hand and weights painted by another one has less to guess about a new character
run       python3 warp.py --character C.glb --count 3 --seed 1 --out folder/
flow      skinned GLB + random factors --each joint's part stretched along and across its bone, blended by the skin
          weights--> rest mesh, joints, inverse binds --> NAME_warp_SEED_K.glb, everything else as it was
          --rigging: joints also move a little and weights are smoothed or sharpened, left and right alike

Part j maps p to A_j (p - joint_j) + joint'_j, A_j = along b b^T + across (1 - b b^T) with b the bone's direction; a
joint follows its parent's part. Rest rotations must be identity, as poses.py needs too. Left and right get the same
factors. Only numpy is needed. The same seed gives the same file.
"""
import argparse, json, os, struct
import numpy as np
from dn import Glb, short

# parts of a humanoid by the start of a joint's name without its side: (range along the bone, range across)
PARTS = {"Hips": ((.92, 1.1), (.9, 1.15)), "Spine": ((.85, 1.15), (.9, 1.2)), "Neck": ((.7, 1.3), (.85, 1.2)),
         "Head": ((.9, 1.3), None), "Shoulder": ((.85, 1.2), (.95, 1.1)), "ForeArm": ((.8, 1.2), (.8, 1.3)),
         "Arm": ((.8, 1.2), (.8, 1.3)), "Hand": ((.85, 1.3), None), "UpLeg": ((.8, 1.2), (.85, 1.2)),
         "Leg": ((.8, 1.2), (.85, 1.25)), "Foot": ((.85, 1.3), None), "Toe": ((.85, 1.3), None)}
LIKE = {"Toe": "Foot"}  # moves with it


def part(name):
    name = name.replace("Left", "").replace("Right", "")
    return next((k for k in PARTS if name.startswith(k)), None)


def warp(positions, joint, weight, joints, parents, names, rng):
    """new rest positions (V,3) and joints (S,3)"""
    factor = {}
    for k, (along, across) in PARTS.items():
        a = rng.uniform(*along)
        factor[k] = factor[LIKE[k]] if k in LIKE else (a, a if across is None else rng.uniform(*across))
    S = len(joints)
    A, new = np.tile(np.eye(3), (S, 1, 1)), np.zeros((S, 3))
    for j in range(S):
        k = part(names[j])
        child = [c for c in range(S) if parents[c] == j]
        bone = joints[child].mean(0) - joints[j] if child else joints[j] - joints[parents[j]]
        b = bone / max(np.linalg.norm(bone), 1e-9)
        along, across = factor[k] if k else (1, 1)
        A[j] = along * np.outer(b, b) + across * (np.eye(3) - np.outer(b, b))
        p = parents[j]
        new[j] = joints[j] if p < 0 else new[p] + A[p] @ (joints[j] - joints[p])
    out = np.zeros_like(positions)
    for i in range(joint.shape[1]):  # like skinning, one influence at a time
        j = joint[:, i]
        out += weight[:, i:i + 1] * (np.einsum("vab,vb->va", A[j], positions - joints[j]) + new[j])
    lift = np.array([0, out[:, 1].min() - positions[:, 1].min(), 0])
    return out - lift, new - lift


def rig(positions, joint, weight, joints, parents, names, triangles, rng):
    """joints moved by about 8 mm (fingers and ends less), weights smoothed over the mesh or sharpened, four a vertex"""
    index, moved = {n: k for k, n in enumerate(names)}, joints.copy()
    for j, n in enumerate(names):
        if n.startswith("Right"):
            continue
        fine = any(k in n for k in ("Thumb", "Index", "Middle", "Ring", "Pinky", "End"))
        d = np.clip(rng.normal(0, .0015 if fine else .008, 3), -.015, .015)
        d[0] *= n.startswith("Left")  # the middle stays in the middle
        moved[j] += d
        other = index.get("Right" + n[4:]) if n.startswith("Left") else None
        if other is not None:
            moved[other] += d * [-1, 1, 1]
    _, node = np.unique(positions, axis=0, return_inverse=True)  # seams smooth as one
    node = node.reshape(-1)
    W = np.zeros((node.max() + 1, len(joints)))
    np.add.at(W, (node[:, None], joint), weight)
    W /= np.maximum(W.sum(1, keepdims=True), 1e-9)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges = np.unique(np.sort(node[edges], 1), axis=0)
    degree = np.maximum(np.bincount(edges.ravel(), minlength=len(W)), 1)[:, None]
    for _ in range(int(rng.integers(0, 7))):
        around = np.zeros_like(W)
        np.add.at(around, edges[:, 0], W[edges[:, 1]])
        np.add.at(around, edges[:, 1], W[edges[:, 0]])
        W = .5 * W + .5 * around / degree
    W = W ** rng.uniform(.75, 1.6)
    top = np.argsort(-W, axis=1, kind="stable")[:, :joint.shape[1]]
    value = np.take_along_axis(W, top, 1)
    value /= value.sum(1, keepdims=True)
    return moved, np.where(value > 0, top, top[:, :1])[node], value[node]


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("--character", required=True)
    ap.add_argument("--count", type=int, default=3)
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--rigging", action="store_true", help="vary joint positions and skin weights too")
    ap.add_argument("--out", required=True)
    a = ap.parse_args()
    os.makedirs(a.out, exist_ok=True)
    rng, base = np.random.default_rng(a.seed), os.path.splitext(os.path.basename(a.character))[0]
    for k in range(a.count):
        g = Glb(a.character)
        node = next(n for n in g.json["nodes"] if "mesh" in n and "skin" in n)
        at, skin = g.json["meshes"][node["mesh"]]["primitives"][0]["attributes"], g.json["skins"][node["skin"]]
        nodes = skin["joints"]
        parent = {c: n for n in nodes for c in g.json["nodes"][n].get("children", [])}
        parents = [nodes.index(parent[n]) if n in parent else -1 for n in nodes]
        joints = -g.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4)[:, 3, :3].astype(float)
        positions = g.accessor(at["POSITION"]).astype(float)
        joint, weight = g.accessor(at["JOINTS_0"]), g.accessor(at["WEIGHTS_0"])
        names = [short(g.json["nodes"][n]["name"]) for n in nodes]
        p, new = warp(positions, joint.astype(int), weight.astype(float), joints, parents, names, rng)
        changed = []
        if a.rigging:
            new, new_joint, new_weight = rig(p, joint.astype(int), weight.astype(float), new, parents, names,
                                             g.accessor(g.json["meshes"][node["mesh"]]["primitives"][0]["indices"]).reshape(-1, 3).astype(int), rng)
            if weight.dtype != np.float32:
                raise SystemExit(f"{a.character}: weights must be floats here")
            changed = [(at["JOINTS_0"], new_joint.astype(joint.dtype)), (at["WEIGHTS_0"], new_weight.astype("<f4"))]
        bind = np.tile(np.eye(4, dtype="<f4"), (len(nodes), 1, 1))
        bind[:, 3, :3] = -new
        blob = bytearray(g.bin)
        for index, data in ((at["POSITION"], p.astype("<f4")), (skin["inverseBindMatrices"], bind), *changed):
            view = g.json["bufferViews"][g.json["accessors"][index]["bufferView"]]
            start = view.get("byteOffset", 0) + g.json["accessors"][index].get("byteOffset", 0)
            if "byteStride" in view:
                raise SystemExit(f"{a.character}: interleaved attributes are not handled here")
            blob[start:start + data.nbytes] = data.tobytes()
        box = g.json["accessors"][at["POSITION"]]
        box["min"], box["max"] = [[float(x) for x in m] for m in (p.astype("<f4").min(0), p.astype("<f4").max(0))]
        at.pop("NORMAL", None)  # of the old shape; readers compute them
        for n, q, j in zip(nodes, parents, range(len(nodes))):
            g.json["nodes"][n]["translation"] = [float(x) for x in new[j] - (new[q] if q >= 0 else 0)]
        head = json.dumps(g.json, separators=(",", ":")).encode()
        head += b" " * (-len(head) % 4)
        name = f"{base}_warp_{a.seed}_{k}"
        with open(os.path.join(a.out, name + ".glb"), "wb") as out:
            out.write(struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(blob)))
            out.write(struct.pack("<I4s", len(head), b"JSON") + head + struct.pack("<I4s", len(blob), b"BIN\0") + blob)
        print(name, "height %.2f m" % np.ptp(p[:, 1]))


if __name__ == "__main__":
    main()
