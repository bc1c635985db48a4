#!/usr/bin/env python3
"""bodies.py - characters of many shapes from a parametric body, as GLB files that flesh and refine read

shows     how shape coefficients become a mesh with joints: template + shape directions . beta, joints likewise
run       python3 bodies.py --body body.safetensors --count 12 --seed 1 --out folder/
flow      body.safetensors + random beta --evaluate--> rest mesh, joints --> body_SEED_K.glb

beta is normal with unit variance, clipped to +-2.2: all that the components were fitted on. Rest rotations are
identity, so an inverse bind matrix is a translation by minus the joint's rest position. Only numpy is needed.
"""
import argparse, json, os, struct
import numpy as np
from safetensors_io import load


def normals(p, f):
    n = np.zeros_like(p)
    c = np.cross(p[f[:, 1]] - p[f[:, 0]], p[f[:, 2]] - p[f[:, 0]])
    for k in range(3):
        np.add.at(n, f[:, k], c)
    return n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-18)


def top4(w):
    """the four largest weights of every row, normalised"""
    w = np.pad(w, ((0, 0), (0, max(0, 4 - w.shape[1]))))
    j = np.argsort(-w, axis=1, kind="stable")[:, :4]
    v = np.take_along_axis(w, j, 1)
    v = v / v.sum(1, keepdims=True)
    return np.where(v > 0, j, 0).astype("<u1"), v.astype("<f4")


def write_character(path, name, p, f, joints, parents, names, w):
    j4, w4 = top4(w)
    inv = np.tile(np.eye(4, dtype="<f4"), (len(joints), 1, 1))
    inv[:, 3, :3] = -joints                                     # column-major: the translation is the last row here
    arrays = [("VEC3", 5126, p.astype("<f4")), ("VEC3", 5126, normals(p, f).astype("<f4")), ("VEC4", 5121, j4),
              ("VEC4", 5126, w4), ("SCALAR", 5125, f.astype("<u4").reshape(-1)), ("MAT4", 5126, inv.reshape(-1, 16))]
    views, acc, blob = [], [], b""
    for kind, ctype, a in arrays:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": a.nbytes})
        acc.append({"bufferView": len(acc), "componentType": ctype, "count": len(a), "type": kind})
        blob += a.tobytes() + b"\0" * (-a.nbytes % 4)
    acc[0]["min"], acc[0]["max"] = [[float(x) for x in m] for m in (p.astype("<f4").min(0), p.astype("<f4").max(0))]
    nodes = []
    for k, n in enumerate(names):
        off = joints[k] - (joints[parents[k]] if parents[k] >= 0 else 0)
        kids = [c for c, q in enumerate(parents) if q == k]
        nodes.append({"name": n, "translation": [float(x) for x in off]} | ({"children": kids} if kids else {}))
    nodes.append({"name": name, "mesh": 0, "skin": 0})
    g = {"asset": {"version": "2.0", "generator": "deformnet bodies.py"}, "scene": 0,
         "scenes": [{"nodes": [k for k, q in enumerate(parents) if q < 0] + [len(names)]}], "nodes": nodes,
         "meshes": [{"name": name, "primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "JOINTS_0": 2, "WEIGHTS_0": 3},
                                                   "indices": 4}]}],
         "skins": [{"joints": list(range(len(names))), "inverseBindMatrices": 5, "skeleton": 0}],
         "buffers": [{"byteLength": len(blob)}], "bufferViews": views, "accessors": acc}
    head = json.dumps(g, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    with open(path, "wb") as out:
        out.write(struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(blob)))
        out.write(struct.pack("<I4s", len(head), b"JSON") + head + struct.pack("<I4s", len(blob), b"BIN\0") + blob)


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("--body", required=True)
    ap.add_argument("--count", type=int, default=8)
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--out", required=True)
    a = ap.parse_args()
    t, meta = load(a.body)
    names = json.loads(meta["joint_names"])
    os.makedirs(a.out, exist_ok=True)
    rng = np.random.default_rng(a.seed)
    for k in range(a.count):
        beta = np.clip(rng.standard_normal(t["shapedirs"].shape[2]), -2.2, 2.2)
        p, joints = t["template"] + t["shapedirs"] @ beta, t["joint_template"] + t["joint_shapedirs"] @ beta
        lift = np.array([0, p[:, 1].min(), 0])                  # feet on the ground
        name = f"body_{a.seed}_{k}"
        write_character(os.path.join(a.out, name + ".glb"), name, p - lift, t["faces"], joints - lift,
                        [int(q) for q in t["parents"]], names, t["weights"])
        print(name, "height %.2f m" % np.ptp(p[:, 1]))


if __name__ == "__main__":
    main()
