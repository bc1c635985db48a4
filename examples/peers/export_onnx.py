#!/usr/bin/env python3
"""export_onnx.py - a deformnet model on one mesh as an ONNX graph, in the form that ONNX Runtime runs fastest

run       python3 export_onnx.py MODEL CASE.network OUT.onnx     CASE.network as bench_deformnet --write leaves it
form      one-rings as a padded table (N,W), the node itself first; all projections of a block in one product; batch norm,
          input and output statistics folded into weights; no scatter. The table is part of the file, as a constant
checks    peers.py compares the outputs with deformnet's
"""
import os
import sys
import warnings

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "train"))
import nets
import safetensors_io as st

FAR = -1e30  # a score that softmax turns into nothing


def fold(layer, width):
    """batch norm as y * scale + shift"""
    if not hasattr(layer, "bn"):
        return torch.ones(width), torch.zeros(width)
    scale = layer.bn.weight * (layer.bn.running_var + nets.EPS).rsqrt()
    return scale, layer.bn.bias - layer.bn.running_mean * scale


class Linear(nn.Module):
    """act(x A + b), everything folded; before and after: statistics of the input and output"""

    def __init__(self, layer, before=None, after=None):
        super().__init__()
        scale, shift = fold(layer, len(layer.bias))
        W, b = layer.weight * scale[:, None], layer.bias * scale + shift
        if before is not None:
            W = W / before.std
            b = b - W @ before.mean
        if after is not None:
            W, b = W * after.std[:, None], b * after.std + after.mean
        self.W, self.b, self.act = W, b, layer.act

    def forward(self, x):
        return nets.activate(F.linear(x, self.W, self.b), self.act)


class Table(nn.Module):
    """one-rings of a graph as constants"""

    def __init__(self, graph):
        super().__init__()
        index, mask = graph.long()
        self.index = index
        self.padding = None if bool(mask.all()) else torch.where(mask, 0.0, FAR)[:, :, None]


class Gat(nn.Module):
    """a GAT block: scores from the unscaled z, then scale and shift of batch norm pass through the softmax's weights"""

    def __init__(self, layer):
        super().__init__()
        K, Fe = layer.att_dst.shape
        own = getattr(layer, "self", None)
        B = len(own.weight) if own else 0
        scale, shift = fold(layer, K * Fe + B)
        W = layer.lin.weight
        score = lambda a: torch.einsum("kfd,kf->kd", W.view(K, Fe, -1), a)
        all_of = torch.cat([W] + ([own.weight] if own else [])) * scale[:, None]
        self.W = torch.cat([all_of, score(layer.att_dst), score(layer.att_src)])
        self.b = torch.cat([shift, torch.zeros(2 * K)])
        self.K, self.Fe, self.B, self.act = K, Fe, B, layer.act

    def forward(self, x, table):
        K, Fe, B = self.K, self.Fe, self.B
        z, own, dst, src = F.linear(x, self.W, self.b).split([K * Fe, B, K, K], 1)
        e = F.leaky_relu(dst[:, None] + src[table.index], nets.SLOPE)
        if table.padding is not None:
            e = e + table.padding
        y = (torch.softmax(e, 1)[..., None] * z.reshape(-1, K, Fe)[table.index]).sum(1).reshape(-1, K * Fe)
        return nets.activate(torch.cat([y, own], 1) if B else y, self.act)


class Pool(nn.Module):
    """the contraction is given; only the scores of the chosen pairs are computed"""

    def __init__(self, pool, graph, contraction):
        super().__init__()
        table, mask = graph.long()
        self.i, self.j = contraction.members.unbind(1)
        self.alone = (contraction.slot == 0)[:, None]
        self.ring = table[self.i][:, 1:]
        self.padding = torch.where(mask[self.i][:, 1:], 0.0, FAR)
        self.slot = (contraction.slot.long() - 1).clamp(min=0)[:, None]
        self.cluster = contraction.cluster
        self.W = torch.cat([pool.att_dst @ pool.lin.weight, pool.att_src @ pool.lin.weight])
        self.offset = float(pool.offset)

    def down(self, x):
        ds = F.linear(x, self.W)
        e = F.leaky_relu(ds[self.i, :1] + ds[:, 1][self.ring], nets.SLOPE) + self.padding
        score = (torch.softmax(e, 1).gather(1, self.slot) + self.offset).clamp(min=nets.LEAST)
        score = torch.where(self.alone, torch.ones_like(score), score)
        vi = x[self.i]
        return torch.where(self.alone, vi, score * (vi + x[self.j])), score

    def up(self, g, score):
        return (g / score)[self.cluster]


def dense(blocks, x, table):
    for block in blocks:
        x = torch.cat([block(x, table), x], 1)
    return x


class Exported(nn.Module):
    def __init__(self, net, graph, pairs):
        super().__init__()
        last = len(net.pre) - 1
        assert last >= 0
        self.pre = nn.ModuleList(Linear(l, before=getattr(net, "input") if k == 0 else None) for k, l in enumerate(net.pre))
        self.post = nn.ModuleList(Linear(l) for l in net.post)
        self.out = Linear(net.out, after=net.output)
        self.table = Table(graph)
        self.multi = isinstance(net, nets.MultiResGNet)
        if self.multi:
            contraction = nets.Contraction.of(graph, pairs)
            self.pool, self.coarse = Pool(net.pool, graph, contraction), Table(contraction.coarse)
            self.local = nn.ModuleList(Gat(l) for l in net.local)
            self.wide = nn.ModuleList(Gat(l) for l in getattr(net, "global"))
        else:
            self.dense = nn.ModuleList(nn.ModuleList(Gat(l) for l in blocks) for blocks in net.dense)
            self.transition = nn.ModuleList(Gat(l) for l in net.transition)

    def forward(self, x):
        for l in self.pre:
            x = l(x)
        if self.multi:
            local = dense(self.local, x, self.table)
            y, score = self.pool.down(x)
            for l in self.wide[:2]:
                y = l(y, self.coarse)
            x = torch.cat([local, self.wide[2](self.pool.up(y, score), self.table)], 1)
        else:
            for m, blocks in enumerate(self.dense):
                x = dense(blocks, x, self.table)
                if m < len(self.transition):
                    x = self.transition[m](x, self.table)
        for l in self.post:
            x = l(x)
        return self.out(x)


class Named:
    """a layer as the classes above expect it, from a file's tensors"""

    def __init__(self, tensors, name, act):
        self.act = act
        for key, value in tensors.items():
            if key.startswith(name + "."):
                at, *path = self, *key[len(name) + 1:].split(".")
                for part in path[:-1]:
                    if part not in vars(at):
                        setattr(at, part, type("Part", (), {})())
                    at = getattr(at, part)
                setattr(at, path[-1], torch.from_numpy(np.array(value)))


class Cloth(nn.Module):
    """the clothing network: coarse rows, detail rows, shape -> both displacements (N,6)"""

    def __init__(self, tensors, graph, pairs):
        super().__init__()
        get = lambda kind, name, act: kind(Named(tensors, name, act))
        self.table = Table(graph)
        self.first = nn.ModuleList(get(Gat, f"{s}.gat", "tanh") for s in ("coarse", "detail"))
        self.parser = nn.ModuleList(get(Linear, f"parser.{k}", "relu") for k in range(3))
        heads = [(b, a) for b, a in (("dir", "tanh"), ("len", "relu"))]
        self.gats = nn.ModuleList(nn.ModuleList(get(Gat, f"{s}.{b}.gat.{k}", a) for k in range(n))
                                  for s, n in (("coarse", 3), ("detail", 4)) for b, a in heads)
        self.post = nn.ModuleList(nn.ModuleList([get(Linear, f"{s}.{b}.post.0", a), get(Linear, f"{s}.{b}.post.1", a),
                                                 get(Linear, f"{s}.{b}.out", "none")])
                                  for s in ("coarse", "detail") for b, a in heads)
        contractions = [nets.Contraction.of(graph, p) for p in pairs]
        self.pools = nn.ModuleList(Pool(Named(tensors, f"detail.{b}.pool", ""), graph, c)
                                   for (b, _), c in zip(heads, contractions))
        self.tables = nn.ModuleList(Table(c.coarse) for c in contractions)
        self.std = [torch.from_numpy(np.array(tensors[f"{s}.output.std"])) for s in ("coarse", "detail")]

    def tail(self, k, x):
        for layer in self.post[k]:
            x = layer(x)
        return x

    def decompose(self, direction, length, std):
        g = torch.tanh(direction)
        return F.relu(length) * g / g.norm(dim=1, keepdim=True).clamp(min=1e-12) * std

    def forward(self, coarse_rows, detail_rows, shape):
        x, heads = self.first[0](coarse_rows, self.table), []
        for k in range(2):
            y = x
            for layer in self.gats[k]:
                y = layer(y, self.table)
            heads.append(self.tail(k, y))
        coarse = self.decompose(heads[0], heads[1], self.std[0])
        for layer in self.parser:
            shape = layer(shape)
        x, heads = self.first[1](detail_rows, self.table) * shape, []
        for k in range(2):
            a, b, c, d = self.gats[2 + k]
            y, score = self.pools[k].down(a(x, self.table))
            y = c(b(y, self.tables[k]), self.tables[k])
            heads.append(self.tail(2 + k, d(self.pools[k].up(y, score), self.table)))
        return torch.cat([coarse, self.decompose(heads[0], heads[1], self.std[1])], 1)


def load(model, case):
    """the module for this mesh, the names of its inputs, the inputs"""
    tensors, meta = st.load(model)
    t, _ = st.load(case)
    with torch.no_grad():
        graph, inputs = nets.Graph.from_csr(t["first"], t["next"]), ["rows"]
        if meta["deformnet.arch"] == "clothnet":
            inputs = ["coarse_rows", "detail_rows", "shape"]
            exported = Cloth(tensors, graph, [t["pairs"], t["pairs_len"]]).eval()
        else:
            exported = Exported(nets.build(meta["deformnet.arch"], tensors), graph, t.get("pairs")).eval()
    return exported, inputs, tuple(torch.from_numpy(np.array(t[name])) for name in inputs)


def main():
    model, case, out = sys.argv[1:]
    torch.set_num_threads(1)
    exported, inputs, rows = load(model, case)
    with torch.no_grad():
        warnings.filterwarnings("ignore", message="The shape inference of")  # about constants; ONNX Runtime infers its own
        torch.onnx.export(exported, rows, out, opset_version=13, input_names=inputs, output_names=["displacement"])
    print(f"{out}: {os.path.getsize(out) / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
