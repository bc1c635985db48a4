#!/usr/bin/env python3
"""make_case.py - a mesh, a pose and random weights of the papers' sizes, as the two files bench_deformnet reads

run       python3 make_case.py --arch densegats --out folder [--shuffle]
mesh      a ring of 140 x 73 vertices, closed, 10,220 in all: each has six neighbours, so that the padded tables of the
          other libraries hold no padding: the best case for them. clothnet: a garment of 70 x 50 around a body of 100 x 70
weights   as fresh ones in training, but batch norm and the input's mean and std hold the statistics of this very mesh, so
          that values keep their size through all layers and a wrong result shows
flow      mesh, pose --numpy--> rows --nets.py, training mode--> statistics --> ARCH.model.safetensors, ARCH.case.safetensors
"""
import argparse
import os
import sys

import numpy as np
import torch

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "train"))
import nets
import safetensors_io as st

AROUND, ABOUT, JOINTS = 140, 73, 65
FEATURES = {"densegats": "position,normal,geodesic", "multiresgnet": "relative,normal,geodesic",
            "clothnet": "normal,relative,fit:1"}


def ring(around=AROUND, about=ABOUT, count=JOINTS, swell=1.0):
    """positions (V,3), triangles (T,3), joints along the core (S,3), turn of each vertex (V)"""
    u, w = np.meshgrid(np.arange(around), np.arange(about), indexing="ij")
    big, small = 0.5, 0.5 * swell * about / around  # metres; even edges on the core circle
    a, b = 2 * np.pi * u.ravel() / around, 2 * np.pi * w.ravel() / about
    r = big + small * np.cos(b)
    positions = np.stack([r * np.cos(a), small * np.sin(b), r * np.sin(a)], 1)
    at = lambda i, j: (i % around * about + j % about).ravel()
    p, q, s, t = at(u, w), at(u + 1, w), at(u + 1, w + 1), at(u, w + 1)
    triangles = np.concatenate([np.stack([p, s, q], 1), np.stack([p, t, s], 1)])
    turn = 2 * np.pi * np.arange(count) / count
    return positions, triangles, big * np.stack([np.cos(turn), 0 * turn, np.sin(turn)], 1), a


def skin(turn, count=JOINTS):
    """the two joints beside each vertex"""
    s = turn / (2 * np.pi) * count
    first = np.floor(s).astype(np.uint32) % count
    part = s - np.floor(s)
    return np.stack([first, (first + 1) % count], 1).astype(np.uint32), np.stack([1 - part, part], 1).astype(np.float32)


def palette(rng, joints):
    """every joint turned a little about its place"""
    axis = rng.normal(size=(len(joints), 3)) * 0.2
    R = np.eye(3) + np.cross(np.eye(3)[None], axis[:, None])
    R = np.stack([np.linalg.qr(m)[0] for m in R])
    R *= np.sign(np.einsum("sii->si", R))[:, None]
    return np.concatenate([R, (joints - np.einsum("sij,sj->si", R, joints))[:, :, None]], 2)


def rows_like(arch, rest, triangles, joint, weight, palette, geodesic):
    """nearly the rows that deformnet makes: only statistics are taken from these"""
    blend = np.einsum("vi,vijk->vjk", weight, palette[joint])
    turned = np.einsum("vjk,vk->vj", blend[:, :, :3], rest)
    posed = turned + blend[:, :, 3]
    face = np.cross(posed[triangles[:, 1]] - posed[triangles[:, 0]], posed[triangles[:, 2]] - posed[triangles[:, 0]])
    normal = np.zeros_like(posed)
    for c in range(3):
        np.add.at(normal, triangles[:, c], face)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.concatenate([posed if arch == "densegats" else turned, normal, geodesic], 1).astype(np.float32)


def graph_of(triangles, n):
    e = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    e = np.unique(np.concatenate([e, e[:, ::-1]]), axis=0)
    return nets.Graph.from_csr(np.searchsorted(e[:, 0], np.arange(n + 1)), e[:, 1])


def cloth(o, rng):
    """the clothing network at the paper's size: weights that keep the rows' size, batch norm that does nothing much"""
    joints = 24
    body, body_triangles, places, turn = ring(100, 70, joints)
    garment, triangles, _, _ = ring(70, 50, joints, 1.02)
    if o.shuffle:
        order = rng.permutation(len(garment))
        garment, triangles = garment[order], np.argsort(order)[triangles]
    joint, weight = skin(turn, joints)
    tensors, f32 = {}, lambda a: np.ascontiguousarray(a, np.float32)

    def linear(name, into, out, gain=1.0):
        tensors[name + ".weight"] = f32(rng.normal(size=(out, into)) * gain / np.sqrt(into))
        tensors[name + ".bias"] = f32(rng.normal(size=out) * 0.1)

    def norm(name, width):
        tensors[name + ".bn.weight"] = f32(rng.uniform(0.8, 1.2, width))
        tensors[name + ".bn.bias"] = f32(rng.normal(size=width) * 0.1)
        tensors[name + ".bn.running_mean"] = f32(rng.normal(size=width) * 0.1)
        tensors[name + ".bn.running_var"] = f32(rng.uniform(0.8, 1.2, width))

    def gat(name, into, out, gain=1.0, bn=False, K=4):
        half = out // 2
        tensors[name + ".lin.weight"] = f32(rng.normal(size=(half, into)) * gain / np.sqrt(into))
        for a in "att_dst", "att_src":
            tensors[f"{name}.{a}"] = f32(rng.normal(size=(K, half // K)) / np.sqrt(half // K))
        tensors[name + ".self.weight"] = f32(rng.normal(size=(half, into)) * gain / np.sqrt(into))
        if bn:
            norm(name, out)
        return out

    def head(prefix, k, into):
        gain = 1.0 if k == 0 else 1.4
        for name, out in ("post.0", 256 if prefix == "coarse" else 128), ("post.1", 128 if prefix == "coarse" else 64):
            linear(f"{prefix}.{'dir' if k == 0 else 'len'}.{name}", into, out, gain)
            if k == 0:
                norm(f"{prefix}.dir.{name}", out)
            into = out
        linear(f"{prefix}.{'dir' if k == 0 else 'len'}.out", into, 3 if k == 0 else 1)

    x = gat("coarse.gat", 7, 256)
    for k, branch in enumerate(["dir", "len"]):
        w = x
        for b, out in enumerate([512, 512, 256]):
            w = gat(f"coarse.{branch}.gat.{b}", w, out, 1.0 if k == 0 else 1.4, k == 0)
        head("coarse", k, w)
    for b, (into, out) in enumerate([(85, 256), (256, 512), (512, 1024)]):
        linear(f"parser.{b}", into, out, 1.4)
    x = gat("detail.gat", 6 + joints, 1024)
    for k, branch in enumerate(["dir", "len"]):
        w = x
        for b, out in enumerate([256, 256, 128, 96]):
            w = gat(f"detail.{branch}.gat.{b}", w, out, 1.0 if k == 0 else 1.4, k == 0)
        tensors[f"detail.{branch}.pool.lin.weight"] = f32(rng.normal(size=(16, 256)) / 16)
        for a in "att_dst", "att_src":
            tensors[f"detail.{branch}.pool.{a}"] = f32(rng.normal(size=(1, 16)) / 4)
        tensors[f"detail.{branch}.pool.offset"] = f32([0.5])  # as PyTorch Geometric: no row is divided by next to nothing
        head("detail", k, w)
    for stage in "coarse", "detail":
        tensors[f"{stage}.output.std"] = f32([0.02] * 3)
    names = ",".join(f"joint{s}" for s in range(joints))
    st.save(os.path.join(o.out, "clothnet.model.safetensors"), tensors, {
        "deformnet.version": "1", "deformnet.arch": "clothnet", "deformnet.features": FEATURES["clothnet"],
        "deformnet.features.detail": "normal,relative,distance", "deformnet.frame": "model", "deformnet.pooling": "rest",
        "deformnet.unit": "1", "deformnet.joints": names, "deformnet.licence": "MIT or public domain",
        "deformnet.trained_on": "nothing: random weights for timing"})
    st.save(os.path.join(o.out, "clothnet.case.safetensors"), {
        "positions": f32(body), "indices": body_triangles.astype(np.int32), "joints": joint.astype(np.int32), "weights": weight,
        "palette": f32(palette(rng, places).reshape(joints, 12)), "garment_positions": f32(garment),
        "garment_indices": triangles.astype(np.int32), "shape": f32(rng.normal(size=(1, 85)) * 0.5)})
    print(f"clothnet: {len(garment)} vertices, {len(triangles)} triangles, rows of 7 and {6 + joints}, "
          f"{sum(t.size for t in tensors.values())} parameters")


def main():
    o = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    o.add_argument("--arch", choices=FEATURES, required=True)
    o.add_argument("--out", required=True)
    o.add_argument("--shuffle", action="store_true", help="vertices in random order: no locality")
    o.add_argument("--seed", type=int, default=1)
    o = o.parse_args()
    rng = np.random.default_rng(o.seed)
    torch.manual_seed(o.seed)
    torch.set_num_threads(1)
    os.makedirs(o.out, exist_ok=True)
    if o.arch == "clothnet":
        cloth(o, rng)
        return
    rest, triangles, joints, turn = ring()
    if o.shuffle:
        order = rng.permutation(len(rest))  # new vertex k is the old order[k]
        rest, turn, triangles = rest[order], turn[order], np.argsort(order)[triangles]
    joint, weight = skin(turn)
    pose = palette(rng, joints)
    geodesic = np.linalg.norm(rest[:, None] - joints[None], axis=2).astype(np.float32)
    rows = torch.from_numpy(rows_like(o.arch, rest, triangles, joint, weight, pose, geodesic))

    net = nets.create(o.arch, rows.shape[1])
    stats = getattr(net, "input")
    stats.mean.copy_(rows.mean(0)), stats.std.copy_(rows.std(0) + 1e-3)
    net.output.mean.normal_(0, 0.002), net.output.std.fill_(0.01)
    with torch.no_grad():
        torch.nn.init.xavier_normal_(net.out.weight)
        for m in net.modules():
            if isinstance(m, nets.BatchNorm):
                m.momentum = 1.0  # one pass: the running statistics become this batch's
                m.weight.uniform_(0.8, 1.6), m.bias.normal_(0, 0.2)
        net.train()
        net.displacement(rows, graph_of(triangles, len(rest)))
    st.save(os.path.join(o.out, f"{o.arch}.model.safetensors"), {k: v.numpy() for k, v in net.state_dict().items()}, {
        "deformnet.version": "1", "deformnet.arch": o.arch, "deformnet.features": FEATURES[o.arch],
        "deformnet.frame": "model", "deformnet.pooling": "rest", "deformnet.unit": "1",
        "deformnet.joints": ",".join(f"joint{s}" for s in range(JOINTS)),
        "deformnet.licence": "MIT or public domain", "deformnet.trained_on": "nothing: random weights for timing"})
    st.save(os.path.join(o.out, f"{o.arch}.case.safetensors"), {
        "positions": rest.astype(np.float32), "indices": triangles.astype(np.int32), "joints": joint.astype(np.int32),
        "weights": weight, "palette": pose.reshape(JOINTS, 12).astype(np.float32), "geodesic": geodesic})
    print(f"{o.arch}: {len(rest)} vertices, {len(triangles)} triangles, rows of {rows.shape[1]}, "
          f"{nets.parameters(net)} parameters")


if __name__ == "__main__":
    main()
