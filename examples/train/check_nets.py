#!/usr/bin/env python3
"""check_nets.py - do nets.py and kernels.c compute what the specification says?

run       python3 check_nets.py GOLDEN.safetensors ...   compare networks with golden vectors: features in, displacement out
          python3 check_nets.py CHARACTER.glb ...        rows of a training batch and of the product, random network through
                                                         both: is what is trained what will run?
          python3 check_nets.py                          kernels.c against plain PyTorch, values and gradients, only
tolerance 1e-5 + 1e-4 |x| for every tensor (specification, section 7); four times that for kernels.c (-ffast-math), whose
          results never ship: deformnet.h computes those
"""
import os
import sys
import tempfile

import numpy as np
import torch

import nets
import safetensors_io as st


def edges_to_graph(faces, n):
    pair = np.concatenate([faces[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))])
    pair = np.unique(np.concatenate([pair, pair[:, ::-1]]), axis=0)
    pair = pair[pair[:, 0] != pair[:, 1]]
    return nets.Graph.from_csr(np.searchsorted(pair[:, 0], np.arange(n + 1)), pair[:, 1])


def golden(path):
    """the worst error as a share of the tolerance, and how many tensors were compared"""
    tensors, meta = st.load(path)
    net, worst, count = nets.build(meta["deformnet.arch"], tensors), 0.0, 0
    for case in sorted({k.split(".")[1] for k in tensors if k.startswith("golden.")}):
        get = lambda name: np.array(tensors[f"golden.{case}.{name}"])
        graph = edges_to_graph(get("out.node_of_vertex")[get("in.faces")], len(get("mid.features")))
        seen = {}
        with torch.no_grad():
            y = net.displacement(torch.from_numpy(get("mid.features")), graph, None, seen.__setitem__).numpy()
        seen = {f"mid.{k}": v for k, v in seen.items()} | {"out.displacement": torch.from_numpy(y)}
        for name, value in seen.items():
            if f"golden.{case}.{name}" not in tensors:
                raise SystemExit(f"{path}: no {name}")
            want = get(name)[0] if name.startswith("out.") else get(name)
            share = (np.abs(value.numpy() - want) / (1e-5 + 1e-4 * np.abs(want))).max() / (4 if nets.C else 1)
            worst, count = max(worst, share), count + 1
            if share > 1:
                print(f"{path} {case} {name}: {share:.2f} of the tolerance")
    return worst, count


def gradients():
    """kernels.c against the plain form on random patches: the largest difference relative to the largest number"""
    rng = np.random.default_rng(1)
    faces, n = rng.integers(0, 60, (110, 3)), 60
    one, kernels = edges_to_graph(np.concatenate([faces, faces + n]), 2 * n), nets.C
    graph = nets.Graph(one.table, one.degree, torch.tensor([0, n, 2 * n]))
    worst = 0.0
    for name, changes in (("multiresgnet:lite", {}), ("multiresgnet:lite", dict(gat_bn=False, K=3, Fe=5, B=7)),
                          ("densegats", {}), ("gat", {}), ("mlp", {}), ("neuroskinning", {})):
        for mode in ("live", "frozen"):
            torch.manual_seed(2)
            net = nets.create(name, 20, **changes).train()
            torch.nn.init.normal_(net.out.weight)  # create() starts from zero, which would hide everything before it
            for m in net.modules():
                if isinstance(m, nets.BatchNorm):
                    m.frozen = mode == "frozen"
            x, result = torch.randn(2 * n, 20), []
            nets.C = None
            with torch.no_grad():
                c = nets.contract(graph, net.pool.edge_scores(net.before_pool(x), graph)) if net.pools else None
            if c:
                c.coarse.offset = torch.searchsorted(c.members.min(1).values, graph.offset)
            for nets.C in (None, kernels):
                net.zero_grad()
                v = x.clone().requires_grad_()
                net(v, graph, c).square().mean().backward()
                result.append({"rows": v.grad} | {k: p.grad.clone() for k, p in net.named_parameters()})
            for k, a in result[0].items():
                if k.endswith(".bias") and k.replace("bias", "bn.bias") in result[0] and mode == "live":
                    continue  # a bias before a live batch norm: its gradient is zero but for rounding
                d = float((a - result[1][k]).abs().max() / (a.abs().max() + 1e-6))
                worst = max(worst, d)
                if d > 2e-3:
                    print(f"{name} {mode} {k}: gradients differ by {d:.1e}")
    return worst


def product(path):
    """a random network on a bent character: rows and displacement of the training path and of dn_deform; the largest
    differences, rows in units of one (metres, unit normals), displacement as a share of the largest"""
    import dn
    features, c = dn.FEATURES, dn.Character(path, resolution=32)
    torch.manual_seed(3)
    net = nets.create("multiresgnet:tiny", dn.row_width(features, len(c.model_joints))).eval()
    torch.nn.init.normal_(net.out.weight, std=0.01)
    rng, palette, turn = np.random.default_rng(4), [], lambda a: rotation(rng.normal(size=3) * a)
    for s, parent in enumerate(c.parents):  # every joint turned a little, the root a lot
        m = palette[parent] if parent >= 0 else np.eye(4)
        local = np.eye(4)
        local[:3, :3] = turn(0.3 if parent >= 0 else 1.5)
        local[:3, 3] = c.joint_positions[s] - local[:3, :3] @ c.joint_positions[s]
        palette.append(m @ local)
    palette = np.array(palette)[:, :3].astype(np.float32)
    rest = np.tile(np.eye(3, 4, dtype=np.float32).reshape(1, 12), (len(c.joint_names), 1))
    batch = lambda p, pool: dn.make_batch([dn.Pose(c, p, c.positions)], features, True, pool=pool)
    c.contract(net.pool.ds(net.before_pool(torch.from_numpy(batch(rest, False)["rows"]))).detach().numpy())
    b = batch(palette.reshape(-1, 12), True)
    t = {k: torch.from_numpy(v) for k, v in b.items() if k != "node"}
    pool = nets.Contraction(t["members"], t["slot"], t["cluster"],
                            nets.Graph(t["coarse_table"], t["coarse_degree"], t["coarse_offset"]))
    with torch.no_grad():
        y = net.displacement(t["rows"], nets.Graph(t["table"], t["degree"], t["offset"]), pool).numpy() @ palette[0, :, :3].T
    with tempfile.TemporaryDirectory() as folder:
        model = os.path.join(folder, "random.safetensors")
        st.save(model, {k: v.numpy() for k, v in net.state_dict().items()},
                {"deformnet.version": 1, "deformnet.arch": "multiresgnet", "deformnet.features": ",".join(features),
                 "deformnet.frame": "root", "deformnet.pooling": "rest", "deformnet.joints": ",".join(c.model_joints)})
        run, plain = dn.Deformer(c, model), dn.Deformer(c)
    moved = (run(palette) - plain(palette))[c.first_vertex]
    return np.abs(run.rows(palette, b["rows"].shape[1]) - b["rows"]).max(), np.abs(moved - y).max() / np.abs(y).max()


def rotation(a):
    """Rodrigues (T 3.8)"""
    angle = np.linalg.norm(a)
    x, y, z = a / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


if __name__ == "__main__":
    bad = False
    if nets.C:
        g = gradients()
        print(f"kernels.c against plain PyTorch: gradients differ by {g:.1e} at most")
        bad |= not g < 2e-3
    for path in [a for a in sys.argv[1:] if a.endswith(".glb")]:
        rows, moved = product(path)
        bad |= not (rows < 1e-3 and moved < 1e-3)
        print(f"{path}: rows of training and product differ by {rows:.1e}, displacements by {moved:.1e} of the largest")
    for path in [a for a in sys.argv[1:] if not a.endswith(".glb")]:
        for nets.C in {None, nets.kernels()}:
            worst, count = golden(path)
            bad |= not worst <= 1
            print(f"{path} ({'kernels.c' if nets.C else 'plain'}): {count} tensors, {worst:.3f} of the tolerance used")
    sys.exit(bad)
