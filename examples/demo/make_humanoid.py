#!/usr/bin/env python3
"""make_humanoid.py - grow the demo's human body: a distance field, a mesh on it, a skeleton in it, its skin weights

shows     where examples/demo/humanoid.safetensors comes from; no modelled asset is read, the numbers
          are in humanoid_field.py
run       python3 make_humanoid.py --out humanoid.safetensors [--glb humanoid.glb]
flow      joints + parts (muscles, bones, fat: swept tubes and ellipsoids) --smooth union--> field f(p), f < 0 inside
          --surface nets, half a body--> fine mesh --split, collapse, flip, relax on f = 0--> even triangles --mirror-->
          body (V,3), (T,3); part fields + joint planes --> weights, smoothed over the mesh, four a vertex

Metres, Y up, facing +Z, the figure's left is +X, feet on y = 0. Only the left half is described; the right half is
its mirror image, vertex for vertex. Only numpy is needed, and the same numpy gives the same file.
"""
import argparse, json, struct, time
import numpy as np
from humanoid_field import FINGERS, MIRROR, Body, place_fingers, skeleton, unit
from humanoid_mesh import mirror, remesh, surface_nets


# ------------------------------------------------------------------------------------------------ skin weights
def step(x, a, b):
    """0 below a, 1 above b, smooth between"""
    t = np.clip((x - a) / (b - a), 0, 1)
    return t * t * (3 - 2 * t)


def chain(ramps):
    """weights of joints 0..n along a chain from the ramps of joints 1..n (each the share handed on to the child)"""
    out, left = [], np.ones_like(ramps[0])
    for r in ramps:
        out.append(left * (1 - r))
        left = left * r
    return out + [left]


def half_weights(p, body, names, rest):
    """weights (V,S) of the left half: which part (from the part fields), how far along it (signed distance to a plane
    through each joint). Falloffs are about a limb radius wide and lie as an artist paints them"""
    J = {n: r for n, r in zip(names, rest)}
    W = np.zeros((len(p), len(names)))
    col = names.index
    plane = lambda joint, a, b, c: (p - J[joint]) @ unit(unit(J[joint] - J[a]) + unit(J[b] - J[joint])) - c
    trunk, leg, arm = body.groups(p)
    x, y, z = p.T

    # spine: planes that tilt forward-down towards the neck and chin
    up = y - .55 * np.maximum(x - .055, 0)                        # the slope of the shoulders stays with the chest
    ramp = [step(y - .25 * z, J["Spine"][1] - .055, J["Spine"][1] + .045),
            step(y, J["Spine1"][1] - .085, J["Spine1"][1] + .035),
            step(y, J["Spine2"][1] - .125, J["Spine2"][1] + .020),
            step(up + .45 * z, J["Neck"][1] - .045, J["Neck"][1] + .030),
            step(y + .55 * z, J["Head"][1] - .030, J["Head"][1] + .035)]
    spine = np.stack(chain(ramp), 1)

    # shoulder: the arm's share grows outward over the shoulder, sooner in front than behind, and ends above a line that
    # falls towards the armpit; the collar takes half of what the chest keeps near it
    dx, dy, dz = (p - J["LeftArm"]).T
    behind = step(-dz, -.02, .03)
    over = step(dx, -.170 + .045 * behind, .090) * (1 - ramp[3])
    high = step(dy + .74 * dx, -.155, -.062)
    on_arm = step(trunk - arm, -.012, .016) * step(x, .12, .17) * (arm < .02)   # which side of the armpit fold
    reach = step(p @ unit((.78, -.62, 0)) - J["LeftArm"] @ unit((.78, -.62, 0)), -.050, .055)
    arm_w = over * high * (1 - on_arm) + np.maximum(over * high, reach) * on_arm
    near = step(x, .015, .105) * step(y, J["LeftArm"][1] - .15, J["LeftArm"][1] - .03) * (1 - step(ramp[3], .0, .9))
    collar = .5 * near * (1 - arm_w)

    # legs: the plane through the hip leans outward; below the crotch the nearer thigh wins
    hip = lambda q: step((q - J["LeftUpLeg"]) @ unit((.58, -.81, 0)), -.075, .080)
    side = step(x, -.016, .016)
    low = 1 - step(y, J["LeftUpLeg"][1] - .02, J["LeftUpLeg"][1] + .10) * (1 - step(x, .06, .13)) * .6
    up_l, up_r = hip(p) * side * low, hip(p * MIRROR) * (1 - side) * low
    up_l = np.where(arm < leg, 0, up_l)

    body_w = spine.copy()
    body_w *= (1 - arm_w - collar)[:, None]
    rest_leg = 1 - up_l - up_r
    for i, n in enumerate(("Hips", "Spine", "Spine1", "Spine2", "Neck", "Head")):
        W[:, col(n)] = body_w[:, i] * rest_leg
    W[:, col("LeftShoulder")] = collar

    knee = step(plane("LeftLeg", "LeftUpLeg", "LeftFoot", 0), -.080, .075)
    ankle = step((p - J["LeftFoot"]) @ unit((0, -.80, .60)), -.050, .045)
    ball = step((p - J["LeftToeBase"]) @ unit((0, -.15, 1)), -.030, .030)
    for n, w in zip(("LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase"), chain([knee, ankle, ball])):
        W[:, col(n)] = up_l * w
    W[:, col("RightUpLeg")] = up_r

    elbow = step(plane("LeftForeArm", "LeftArm", "LeftHand", 0), -.055, .030)
    wrist = step(plane("LeftHand", "LeftForeArm", "LeftHandMiddle1", 0), -.045, .030)
    up, fore, hand = chain([elbow, wrist])
    W[:, col("LeftArm")], W[:, col("LeftForeArm")] = arm_w * up, arm_w * fore

    # fingers: the nearest one (by distance to its bones over its radius) takes over beyond its knuckle
    near, ramps = [], []
    for name in ("Thumb",) + tuple(FINGERS):
        q = [J[f"LeftHand{name}{i}"] for i in (1, 2, 3, 4)]
        d = np.full(len(p), np.inf)
        for a, b in zip(q, q[1:]):
            t = np.clip((p - a) @ (b - a) / np.dot(b - a, b - a), 0, 1)
            d = np.minimum(d, np.linalg.norm(p - a - t[:, None] * (b - a), axis=1))
        near.append(d)
        first = unit(q[1] - q[0])
        r = [step((p - q[0]) @ first, -.016 if name == "Thumb" else -.009, .028 if name == "Thumb" else .011)]
        r += [step((p - q[i]) @ unit(unit(q[i] - q[i - 1]) + unit(q[i + 1] - q[i])), -.009, .007) for i in (1, 2)]
        ramps.append(chain(r))
    near = np.stack(near, 1)
    which, gap = near.argmin(1), np.sort(near, axis=1)
    sure = step(gap[:, 1] - gap[:, 0], -.002, .006)
    palm = np.ones(len(p))
    for k, name in enumerate(("Thumb",) + tuple(FINGERS)):
        m = (which == k) & (gap[:, 0] < (.026 if name == "Thumb" else .016))
        share = np.where(m, .5 + .5 * sure if name != "Thumb" else 1.0, 0)
        for i in (1, 2, 3):
            w = ramps[k][i] * share
            W[:, col(f"LeftHand{name}{i}")] = arm_w * hand * w
            palm -= w
    W[:, col("LeftHand")] = arm_w * hand * palm
    return W / W.sum(1, keepdims=True)


def smooth_weights(W, verts, tris, passes):
    """diffusion over the surface, each neighbour weighted by 1/edge length; fine meshes are moved less far"""
    e = np.vstack([tris[:, :2], tris[:, 1:], tris[:, [2, 0]]])
    e = np.unique(np.sort(e, axis=1), axis=0)
    w = 1 / np.linalg.norm(verts[e[:, 0]] - verts[e[:, 1]], axis=1)
    n = np.bincount(e[:, 0], w, len(W)) + np.bincount(e[:, 1], w, len(W))
    for _ in range(passes):
        s = np.zeros_like(W)
        for c in range(W.shape[1]):
            if W[:, c].any():
                s[:, c] = (np.bincount(e[:, 0], w * W[e[:, 1], c], len(W))
                           + np.bincount(e[:, 1], w * W[e[:, 0], c], len(W)))
        W = .5 * W + .5 * s / n[:, None]
    return W


def four(W, floor=.004):
    """the four largest of each row, those below `floor` dropped, normalised: joints (V,4), weights (V,4)"""
    j = np.argsort(-W, axis=1, kind="stable")[:, :4]
    w = np.take_along_axis(W, j, 1)
    w[w < floor * w[:, :1]] = 0
    w = (w / w.sum(1, keepdims=True)).astype(np.float32)
    return np.where(w > 0, j, 0).astype(np.int32), w


def skin(verts, tris, other, count, body, names, rest):
    """weights of the whole figure: the left half's, mirrored; the mirror plane takes the mean of both sides"""
    half = half_weights(verts[:count], body, names, rest)
    swap = np.array([names.index(n.replace("Left", "#").replace("Right", "Left").replace("#", "Right")) for n in names])
    W = np.zeros((len(verts), len(names)))
    W[:count] = half
    own = other[:count] >= count
    W[other[:count][own]] = half[own][:, swap]
    W[:count][~own] = (half[~own] + half[~own][:, swap]) / 2
    W = smooth_weights(W, verts, tris, 3)
    return four(W)


# ------------------------------------------------------------------------------------------------ check and write
def check(verts, tris, w, j):
    """closed, manifold, one piece, outward, weights in order; raises if not"""
    d = np.vstack([tris[:, :2], tris[:, 1:], tris[:, [2, 0]]])
    key = d[:, 0] * len(verts) + d[:, 1]
    twice = np.flatnonzero(np.bincount(np.unique(key, return_inverse=True)[1]) > 1)
    where = verts[np.unique(key)[twice] // len(verts)][:4].round(3).tolist()
    assert not len(twice), f"edges used twice in one direction near {where}"
    assert np.isin(d[:, 1] * len(verts) + d[:, 0], key).all(), "open edge"
    root = np.arange(len(verts))
    while True:
        new = root.copy()
        np.minimum.at(new, d[:, 0], root[d[:, 1]])
        new = new[new]
        if (new == root).all():
            break
        root = new
    assert (root == 0).all(), "more than one piece"
    a, b, c = (verts[tris[:, k]] for k in range(3))
    volume = (a * np.cross(b, c)).sum() / 6
    assert volume > 0, "inside out"
    euler = len(verts) - len(d) // 2 + len(tris)
    assert euler == 2, f"holes in the body: Euler characteristic {euler}, not 2"
    assert np.isfinite(verts).all() and abs(w.sum(1) - 1).max() < 1e-6 and w.min() >= 0 and j.min() >= 0
    length = np.linalg.norm(verts[d[:, 0]] - verts[d[:, 1]], axis=1)
    corner = []
    for k in range(3):
        u, v = verts[tris[:, (k + 1) % 3]] - verts[tris[:, k]], verts[tris[:, (k + 2) % 3]] - verts[tris[:, k]]
        cosine = (u * v).sum(1) / np.linalg.norm(u, axis=1) / np.linalg.norm(v, axis=1)
        corner.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    angle = np.min(corner, axis=0)
    mm = np.array([length.min(), np.median(length), length.max()]) * 1000
    return (f"{len(verts)} vertices, {len(tris)} triangles, {volume * 1000:.1f} litres, {verts[:, 1].max():.3f} m; "
            f"edges {mm[0]:.1f} / {mm[1]:.1f} / {mm[2]:.1f} mm (least, median, most); "
            f"smallest angle of a triangle {angle.min():.0f} degrees, median {np.median(angle):.0f}")


def write_safetensors(path, tensors, meta):
    head, at = {"__metadata__": meta}, 0
    kind = {"float32": "F32", "int32": "I32"}
    for name, a in tensors.items():
        head[name] = {"dtype": kind[a.dtype.name], "shape": list(a.shape), "data_offsets": [at, at + a.nbytes]}
        at += a.nbytes
    text = json.dumps(head, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    with open(path, "wb") as f:
        f.write(struct.pack("<Q", len(text)) + text)
        for a in tensors.values():
            f.write(np.ascontiguousarray(a).tobytes())


def write_glb(path, verts, tris, j, w, names, parents, rest):
    inverse = np.tile(np.eye(4), (len(names), 1, 1))
    inverse[:, :3, 3] = -rest
    n = np.zeros_like(verts)
    fn = np.cross(verts[tris[:, 1]] - verts[tris[:, 0]], verts[tris[:, 2]] - verts[tris[:, 0]])
    for k in range(3):
        np.add.at(n, tris[:, k], fn)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    blobs = [(verts.astype("<f4"), 5126, "VEC3"), (n.astype("<f4"), 5126, "VEC3"), (j.astype("u1"), 5121, "VEC4"),
             (w.astype("<f4"), 5126, "VEC4"), (tris.astype("<u4").reshape(-1), 5125, "SCALAR"),
             (inverse.transpose(0, 2, 1).reshape(-1, 16).astype("<f4"), 5126, "MAT4")]
    views, acc, data = [], [], b""
    for a, kind, shape in blobs:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": a.nbytes})
        acc.append({"bufferView": len(views) - 1, "componentType": kind, "count": len(a), "type": shape})
        data += a.tobytes() + b"\0" * (-a.nbytes % 4)
    box = verts.astype("<f4")
    acc[0] |= {"min": [float(x) for x in box.min(0)], "max": [float(x) for x in box.max(0)]}
    nodes = []
    for k, name in enumerate(names):
        off = rest[k] - (rest[parents[k]] if parents[k] >= 0 else 0)
        kids = [c for c in range(len(names)) if parents[c] == k]
        node = {"name": "mixamorig:" + name, "translation": [float(x) for x in off]}
        nodes.append(node | ({"children": kids} if kids else {}))
    nodes.append({"name": "humanoid", "mesh": 0, "skin": 0})
    g = {"asset": {"version": "2.0", "generator": "deformnet make_humanoid.py", "copyright": "CC0"}, "scene": 0,
         "scenes": [{"nodes": [0, len(names)]}], "nodes": nodes, "buffers": [{"byteLength": len(data)}],
         "bufferViews": views, "accessors": acc,
         "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [.8, .62, .52, 1], "metallicFactor": 0}}],
         "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "JOINTS_0": 2, "WEIGHTS_0": 3},
                                     "indices": 4, "material": 0}]}],
         "skins": [{"joints": list(range(len(names))), "skeleton": 0, "inverseBindMatrices": 5}]}
    head = json.dumps(g, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    with open(path, "wb") as f:
        f.write(struct.pack("<4sII", b"glTF", 2, 28 + len(head) + len(data)))
        f.write(struct.pack("<I4s", len(head), b"JSON") + head + struct.pack("<I4s", len(data), b"BIN\0") + data)


def build(cell=.005, log=lambda *a: None):
    place_fingers()
    names, parents, rest = skeleton()
    body = Body()
    verts, tris = surface_nets(body, cell)
    log(f"surface nets: {len(verts)} vertices on half a body")
    verts, tris = remesh(verts, tris, body, log=log)
    count = len(verts)
    verts, tris, other = mirror(verts, tris)
    j, w = skin(verts, tris, other, count, body, names, rest)
    return verts, tris, j, w, names, parents, rest


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("--out", required=True, help="character, safetensors")
    ap.add_argument("--glb", help="the same character as GLB")
    a = ap.parse_args()
    start = time.time()
    log = lambda s: print(f"{time.time() - start:5.1f} s  {s}", flush=True)
    verts, tris, j, w, names, parents, rest = build(log=log)
    inverse = np.zeros((len(names), 3, 4))
    inverse[:, :, :3] = np.eye(3)
    inverse[:, :, 3] = -rest
    write_safetensors(a.out, {
        "positions": verts.astype("<f4"), "triangles": tris.astype("<i4"), "skin_joints": j.astype("<i4"),
        "skin_weights": w.astype("<f4"), "joint_rest": rest.astype("<f4"), "parents": parents.astype("<i4"),
        "inverse_bind": inverse.astype("<f4")},
        {"joint_names": ",".join("mixamorig:" + n for n in names), "licence": "CC0",
         "source": "made by examples/demo/make_humanoid.py", "units": "metres, Y up, facing +Z"})
    if a.glb:
        write_glb(a.glb, verts, tris, j, w, names, parents, rest)
    log(f"wrote {a.out}")
    log(check(verts, tris, w, j))


if __name__ == "__main__":
    main()
