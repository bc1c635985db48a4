#!/usr/bin/env python3
"""check_nets.py - do nets.py and kernels.c compute what the specification says?

run       python3 check_nets.py GOLDEN.safetensors ...   compare networks with golden vectors: features in, displacement out
          python3 check_nets.py                          kernels.c against plain PyTorch, values and gradients, only
tolerance 1e-5 + 1e-4 |x| for every tensor (specification, section 7)
"""
import sys

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
            share = (np.abs(value.numpy() - want) / (1e-5 + 1e-4 * np.abs(want))).max()
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


if __name__ == "__main__":
    bad = False
    if nets.C:
        g = gradients()
        print(f"kernels.c against plain PyTorch: gradients differ by {g:.1e} at most")
        bad |= not g < 2e-3
    for path in sys.argv[1:]:
        for nets.C in {None, nets.kernels()}:
            worst, count = golden(path)
            bad |= not worst <= 1
            print(f"{path} ({'kernels.c' if nets.C else 'plain'}): {count} tensors, {worst:.3f} of the tolerance used")
    sys.exit(bad)
