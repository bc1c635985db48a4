"""nets.py - the networks of deformnet.h in PyTorch, for training

shows     densegats, multiresgnet and the baselines mlp, gat, neuroskinning. Modules and tensors carry the names of the
          model file ("local.0.att_dst"), so a state_dict is a model file, and the loader of a model file is build().
flow      rows (n,D) --pre--> --graph layers--> --post--> out (n,3) = displacement, metres
speed     on a CPU the graph parts run in kernels.c (values and gradients by hand); elsewhere the plain form beside each
          is used. check_nets.py holds them against each other.
papers    T = Li, thesis on mesh deformation with graph networks; equation numbers are T's

A batch is a disjoint union of patches; Graph and Contraction describe it.
"""
import ctypes
import os

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

EPS = 1e-5       # of batch norm
LEAST = 1e-6     # a pooling score counts as at least this
SLOPE = 0.2      # of the LeakyReLU in the scores
MAX_HEADS = 64   # of kernels.c
ACTIVATIONS = {"none": 0, "tanh": 1, "tanhshrink": 2, "relu": 3}


def kernels():
    """kernels.c, or None when it was not built or DEFORMNET_PLAIN is set"""
    path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "libdeformnet.so")
    return ctypes.CDLL(path) if os.path.exists(path) and not os.environ.get("DEFORMNET_PLAIN") else None


C = kernels()


def ptr(t):
    """address of a contiguous tensor or array"""
    if isinstance(t, np.ndarray):
        assert t.flags.c_contiguous
        return ctypes.c_void_p(t.ctypes.data)
    assert t.is_contiguous()
    return ctypes.c_void_p(t.data_ptr())


def size(n):
    return ctypes.c_size_t(n)


class Graph:
    """one-rings: table (n,W) int32, column 0 the node itself, then its neighbours; degree (n) columns used;
    offset (P+1) int64, where each patch begins: neighbours never cross patches"""

    def __init__(self, table, degree, offset=None):
        self.table, self.degree = table, degree
        self.offset = torch.tensor([0, len(table)], dtype=torch.int64) if offset is None else offset

    @staticmethod
    def from_csr(first, nxt):
        """from dn_graph's arrays"""
        first, nxt = np.asarray(first, np.int64), np.asarray(nxt)
        n, degree = len(first) - 1, np.diff(first) + 1
        table = np.tile(np.arange(n, dtype=np.int32)[:, None], (1, int(degree.max())))
        row = np.repeat(np.arange(n), degree - 1)
        table[row, np.arange(len(nxt)) - first[row] + 1] = nxt
        return Graph(torch.from_numpy(table), torch.from_numpy(degree.astype(np.int32)))

    def long(self):
        """the table as torch indexes it, and a mask of the entries used (n,W)"""
        if not hasattr(self, "_long"):
            self._long = self.table.long()
            self._mask = torch.arange(self.table.shape[1], device=self.table.device)[None] < self.degree[:, None]
        return self._long, self._mask

    def to(self, device):
        return Graph(self.table.to(device), self.degree.to(device), self.offset)


class Contraction:
    """members (m,2) int64: the directed pair of each coarse node, (i,i) for one left alone; cluster (n) int64;
    slot (m) int32: the column of j in row i of the fine table, 0 for a node alone; coarse: its Graph"""

    def __init__(self, members, slot, cluster, coarse):
        self.members, self.slot, self.cluster, self.coarse = members, slot, cluster, coarse

    @staticmethod
    def of(graph, members):
        """from a list of directed pairs (one patch): used with whole meshes"""
        table, degree = graph.table.numpy(), graph.degree.numpy()
        members = np.ascontiguousarray(np.asarray(members, np.int64))
        m = len(members)
        cluster = np.empty(len(table), np.int64)
        cluster[members[:, 0]] = cluster[members[:, 1]] = np.arange(m)
        pair = members[:, 0] != members[:, 1]
        slot = np.where(pair, (table[members[:, 0]] == members[:, 1:2]).argmax(1), 0).astype(np.int32)
        row = np.repeat(np.arange(len(table)), degree)
        column = np.arange(len(row)) - np.repeat(np.cumsum(degree) - degree, degree)
        edges = np.stack([cluster[row], cluster[table[row, column]]], 1)
        edges = np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0)
        first = np.searchsorted(edges[:, 0], np.arange(m + 1))
        return Contraction(torch.from_numpy(members), torch.from_numpy(slot), torch.from_numpy(cluster),
                           Graph.from_csr(first, edges[:, 1]))

    def to(self, device):
        return Contraction(self.members.to(device), self.slot.to(device), self.cluster.to(device), self.coarse.to(device))


# ------------------------------------------------------------------------------------------------ operations
def attention_plain(u, graph, K, Fe, B):
    """u (n, K*F + B + 2K) = [z | self | dst | src] -> (n, K*F + B); T 3.4, 3.5"""
    n, (table, mask) = len(u), graph.long()
    z, own, dst, src = u.split([K * Fe, B, K, K], 1)
    e = F.leaky_relu(dst[:, None] + src[table], SLOPE).masked_fill(~mask[..., None], -1e30)
    y = (torch.softmax(e, 1)[..., None] * z.reshape(n, K, Fe)[table]).sum(1).reshape(n, K * Fe)
    return torch.cat([y, own], 1) if B else y


class Attention(torch.autograd.Function):
    """the same by kernels.c"""

    @staticmethod
    def forward(ctx, u, graph, K, Fe, B):
        n, width = graph.table.shape
        u = u.contiguous()
        y, alpha = u.new_empty(n, K * Fe + B), u.new_empty(n, width, K)
        C.dnt_gat_forward(ptr(u), size(u.shape[1]), ptr(graph.table), size(width), ptr(graph.degree), ptr(graph.offset),
                          size(len(graph.offset) - 1), size(K), size(Fe), size(B), ptr(y), ptr(alpha))
        ctx.save_for_backward(u, alpha)
        ctx.graph, ctx.shape = graph, (K, Fe, B)
        return y

    @staticmethod
    def backward(ctx, gy):
        (u, alpha), graph, (K, Fe, B) = ctx.saved_tensors, ctx.graph, ctx.shape
        gy, gu = gy.contiguous(), torch.empty_like(u)
        C.dnt_gat_backward(ptr(u), size(u.shape[1]), ptr(graph.table), size(graph.table.shape[1]), ptr(graph.degree),
                           ptr(graph.offset), size(len(graph.offset) - 1), size(K), size(Fe), size(B), ptr(alpha), ptr(gy),
                           ptr(gu))
        return gu, None, None, None, None


class NormAct(torch.autograd.Function):
    """act(weight * (x - mean) * rstd + bias) by kernels.c; live: mean and rstd are this batch's"""

    @staticmethod
    def forward(ctx, x, weight, bias, mean, rstd, act, live):
        x, y = x.contiguous(), torch.empty_like(x)
        C.dnt_norm_forward(ptr(x), size(len(x)), size(x.shape[1]), ptr(mean), ptr(rstd), ptr(weight), ptr(bias), act, ptr(y))
        ctx.save_for_backward(x, y, weight, bias, mean, rstd)
        ctx.act, ctx.live = act, live
        return y

    @staticmethod
    def backward(ctx, gy):
        x, y, weight, bias, mean, rstd = ctx.saved_tensors
        gy, gx, gw, gb = gy.contiguous(), torch.empty_like(x), torch.empty_like(weight), torch.empty_like(bias)
        C.dnt_norm_backward(ptr(x), ptr(y), ptr(gy), size(len(x)), size(x.shape[1]), ptr(mean), ptr(rstd), ptr(weight),
                            ptr(bias), ctx.act, int(ctx.live), ptr(gx), ptr(gw), ptr(gb))
        return gx, gw, gb, None, None, None, None


def activate(y, act):
    return {"none": lambda v: v, "tanh": torch.tanh, "relu": torch.relu, "tanhshrink": F.tanhshrink}[act](y)


class BatchNorm(nn.Module):
    """over all rows of a batch. `frozen`: use the running statistics while the weights still train, so that what is
    trained is what will run"""

    def __init__(self, width):
        super().__init__()
        self.weight, self.bias = nn.Parameter(torch.ones(width)), nn.Parameter(torch.zeros(width))
        self.register_buffer("running_mean", torch.zeros(width))
        self.register_buffer("running_var", torch.ones(width))
        self.frozen, self.momentum = False, 0.02

    def forward(self, y, act):
        live = self.training and not self.frozen
        if live:
            with torch.no_grad():
                if C and not y.is_cuda and y.dtype == torch.float32:
                    mean, var = torch.empty_like(self.running_mean), torch.empty_like(self.running_var)
                    C.dnt_moments(ptr(y), size(len(y)), size(y.shape[1]), ptr(mean), ptr(var))
                else:
                    var, mean = torch.var_mean(y, 0, unbiased=False)
                self.running_mean.lerp_(mean, self.momentum)
                self.running_var.lerp_(var, self.momentum)
        else:
            mean, var = self.running_mean, self.running_var
        if C and not y.is_cuda and y.dtype == torch.float32:
            return NormAct.apply(y, self.weight, self.bias, mean, (var + EPS).rsqrt(), ACTIVATIONS[act], live)
        if live:
            return activate(F.batch_norm(y, None, None, self.weight, self.bias, True, 0.0, EPS), act)
        return activate(F.batch_norm(y, mean, var, self.weight, self.bias, False, 0.0, EPS), act)


def norm_act(module, y, act):
    return module.bn(y, act) if hasattr(module, "bn") else activate(y, act)


# ------------------------------------------------------------------------------------------------ layers
class Linear(nn.Module):
    """act(bn(W x + b)); with `whiten` (inputs, inputs) what is learnt is U, and W = U whiten"""

    def __init__(self, inputs, outputs, act, bn):
        super().__init__()
        self.act, self.whiten = act, None
        self.weight = nn.Parameter(torch.empty(outputs, inputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.xavier_normal_(self.weight)
        if bn:
            self.bn = BatchNorm(outputs)

    def forward(self, x, graph=None):
        weight = self.weight if self.whiten is None else self.weight @ self.whiten
        return norm_act(self, F.linear(x, weight, self.bias), self.act)


class Lin(nn.Module):
    """a bare matrix, so that tensors are called name.lin.weight and name.self.weight"""

    def __init__(self, inputs, outputs):
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outputs, inputs))
        nn.init.xavier_normal_(self.weight)


class GAT(nn.Module):
    """self-reinforced graph attention (T 3.2 - 3.5); B = 0: a plain GAT layer"""

    def __init__(self, inputs, K, Fe, B, act, bn):
        super().__init__()
        assert K <= MAX_HEADS
        self.act, self.outputs = act, K * Fe + B
        self.lin = Lin(inputs, K * Fe)
        self.att_dst, self.att_src = nn.Parameter(torch.empty(K, Fe)), nn.Parameter(torch.empty(K, Fe))
        nn.init.xavier_normal_(self.att_dst)
        nn.init.xavier_normal_(self.att_src)
        if B:
            self.add_module("self", Lin(inputs, B))
        if bn:
            self.bn = BatchNorm(self.outputs)

    def forward(self, x, graph):
        K, Fe = self.att_dst.shape
        own = getattr(self, "self", None)
        W = self.lin.weight.view(K, Fe, -1)  # scores are linear in v too: dst_i = (W^T att_dst) v_i, one product for all
        dst, src = torch.einsum("kfd,kf->kd", W, self.att_dst), torch.einsum("kfd,kf->kd", W, self.att_src)
        u = F.linear(x, torch.cat([self.lin.weight] + ([own.weight] if own else []) + [dst, src]))
        B = len(own.weight) if own else 0
        fast = C and not u.is_cuda and u.dtype == torch.float32
        y = Attention.apply(u, graph, K, Fe, B) if fast else attention_plain(u, graph, K, Fe, B)
        return norm_act(self, y, self.act)


class PoolScore(torch.autograd.Function):
    @staticmethod
    def forward(ctx, ds, graph, contraction, offset):
        ds, m, width = ds.contiguous(), len(contraction.members), graph.table.shape[1]
        score, soft = ds.new_empty(m), ds.new_empty(m, width)
        C.dnt_pool_score(ptr(ds), ptr(graph.table), size(width), ptr(graph.degree), ptr(contraction.members),
                         ptr(contraction.slot), size(m), ctypes.c_float(offset), ptr(score), ptr(soft))
        ctx.save_for_backward(ds, soft)
        ctx.graph, ctx.contraction = graph, contraction
        return score

    @staticmethod
    def backward(ctx, g):
        (ds, soft), graph, c = ctx.saved_tensors, ctx.graph, ctx.contraction
        g, gds = g.contiguous(), torch.zeros_like(ds)
        C.dnt_pool_score_back(ptr(ds), ptr(graph.table), size(graph.table.shape[1]), ptr(graph.degree), ptr(c.members),
                              ptr(c.slot), size(len(c.members)), ptr(soft), ptr(g), ptr(gds))
        return gds, None, None, None


class PoolDown(torch.autograd.Function):
    @staticmethod
    def forward(ctx, v, score, members):
        v, score = v.contiguous(), score.contiguous()
        coarse = v.new_empty(len(members), v.shape[1])
        C.dnt_pool_down(ptr(v), ptr(members), ptr(score), size(len(members)), size(v.shape[1]), ptr(coarse))
        ctx.save_for_backward(v, score, members)
        return coarse

    @staticmethod
    def backward(ctx, g):
        v, score, members = ctx.saved_tensors
        g, gv, gs = g.contiguous(), torch.empty_like(v), torch.empty_like(score)
        C.dnt_pool_down_back(ptr(v), ptr(g), ptr(members), ptr(score), size(len(members)), size(v.shape[1]), ptr(gv), ptr(gs))
        return gv, gs, None


class PoolUp(torch.autograd.Function):
    @staticmethod
    def forward(ctx, coarse, score, members, n):
        coarse, score = coarse.contiguous(), score.contiguous()
        v = coarse.new_empty(n, coarse.shape[1])
        C.dnt_pool_up(ptr(coarse), ptr(members), ptr(score), size(len(members)), size(v.shape[1]), ptr(v))
        ctx.save_for_backward(coarse, score, members)
        return v

    @staticmethod
    def backward(ctx, gv):
        coarse, score, members = ctx.saved_tensors
        gv, g, gs = gv.contiguous(), torch.empty_like(coarse), torch.empty_like(score)
        C.dnt_pool_up_back(ptr(coarse), ptr(gv), ptr(members), ptr(score), size(len(members)), size(gv.shape[1]), ptr(g), ptr(gs))
        return g, gs, None, None


class Pool(nn.Module):
    """edge contraction (T 3.10 - 3.12): score() of the chosen pairs, down() to the coarse graph, up() again"""

    def __init__(self, inputs, Fe):
        super().__init__()
        self.lin = Lin(inputs, Fe)
        self.att_dst, self.att_src = nn.Parameter(torch.empty(1, Fe)), nn.Parameter(torch.empty(1, Fe))
        nn.init.xavier_normal_(self.att_dst)
        nn.init.xavier_normal_(self.att_src)
        self.offset = 0.0  # the file's optional tensor; training leaves it out

    def ds(self, x):
        """(n,2): the two halves of every score"""
        return F.linear(x, torch.cat([self.att_dst @ self.lin.weight, self.att_src @ self.lin.weight]))

    def edge_scores(self, x, graph):
        """scores of all directed edges, (n,W) with column 0 unused: what the greedy contraction sorts"""
        (table, mask), ds = graph.long(), self.ds(x)
        e = F.leaky_relu(ds[:, :1] + ds[:, 1][table], SLOPE).masked_fill(~mask, -1e30)
        e[:, 0] = -1e30
        return torch.softmax(e, 1) + self.offset

    def score(self, x, graph, contraction):
        alone = contraction.slot == 0
        if C and not x.is_cuda and x.dtype == torch.float32:
            score = PoolScore.apply(self.ds(x), graph, contraction, self.offset)
        else:
            i, (table, mask), ds = contraction.members[:, 0], graph.long(), self.ds(x)
            e = F.leaky_relu(ds[i, :1] + ds[:, 1][table[i]], SLOPE).masked_fill(~mask[i], -1e30)
            e = torch.cat([torch.full_like(e[:, :1], -1e30), e[:, 1:]], 1)
            score = torch.softmax(e, 1).gather(1, contraction.slot.long()[:, None])[:, 0] + self.offset
            score = torch.where(alone, torch.ones_like(score), score)
        return score.clamp(min=LEAST)

    def down(self, v, score, contraction):
        if C and not v.is_cuda and v.dtype == torch.float32:
            return PoolDown.apply(v, score, contraction.members)
        i, j = contraction.members.unbind(1)
        return torch.where((i == j)[:, None], v[i], score[:, None] * (v[i] + v[j]))

    def up(self, coarse, score, contraction):
        if C and not coarse.is_cuda and coarse.dtype == torch.float32:
            return PoolUp.apply(coarse, score, contraction.members, len(contraction.cluster))
        return (coarse / score[:, None])[contraction.cluster]


def contract(graph, scores):
    """greedy contraction of a whole mesh: directed edges by falling score, ties by smaller i, then j (spec section 4).
    scores (n,W) from Pool.edge_scores -> Contraction"""
    table, degree = graph.table.numpy(), graph.degree.numpy()
    row = np.repeat(np.arange(len(table)), degree - 1)
    column = np.arange(len(row)) - np.repeat(np.cumsum(degree - 1) - (degree - 1), degree - 1) + 1
    s, other = scores.detach().numpy()[row, column], table[row, column]
    order = np.lexsort((other, row, -s))
    partner, first = [-1] * len(table), [-1] * len(table)
    for i, j in zip(row[order].tolist(), other[order].tolist()):
        if partner[i] < 0 and partner[j] < 0:
            partner[i], partner[j], first[i], first[j] = j, i, i, i
    members = [(first[i], partner[first[i]]) if partner[i] >= 0 else (i, i)
               for i in range(len(table)) if partner[i] < 0 or i < partner[i]]
    return Contraction.of(graph, members)


# ------------------------------------------------------------------------------------------------ networks
class Stats(nn.Module):
    """input.mean, input.std; output.mean, output.std"""

    def __init__(self, width):
        super().__init__()
        self.register_buffer("mean", torch.zeros(width))
        self.register_buffer("std", torch.ones(width))


def ring(layers):
    return nn.ModuleList(layers)


class Network(nn.Module):
    """what all have in common: normalised rows in, normalised displacement out"""
    pools = ()  # names of the pooling layers

    def __init__(self, D):
        super().__init__()
        self.add_module("input", Stats(D))
        self.add_module("output", Stats(3))

    def displacement(self, rows, graph, contraction=None, tap=lambda name, value: None):
        """rows (n,D) as deformnet.h makes them -> metres (n,3)"""
        i, o = getattr(self, "input"), self.output
        return self((rows - i.mean) / i.std, graph, contraction, tap) * o.std + o.mean

    def run(self, layers, name, x, graph, tap):
        for b, layer in enumerate(layers):
            x = layer(x, graph)
            tap(f"{name}.{b}", x)
        return x

    def dense_module(self, layers, name, x, graph, tap):
        """a dense module (T 3.6): newest first"""
        for b, layer in enumerate(layers):
            y = layer(x, graph)
            tap(f"{name}.{b}", y)
            x = torch.cat([y, x], 1)
        return x


def linears(widths, act, bn):
    return ring(Linear(a, b, act, bn) for a, b in zip(widths, widths[1:]))


class MultiResGNet(Network):
    """T 3.3"""
    pools = ("pool",)

    def __init__(self, D, pre=(64, 32), local=2, K=8, Fe=16, B=128, post=(256, 64), gat_bn=True, bn=True, pool=16):
        super().__init__(D)
        block = lambda d: GAT(d, K, Fe, B, "tanhshrink", gat_bn)
        w, d = K * Fe + B, pre[-1]
        self.pre = linears((D, *pre), "tanh", bn)
        self.local = ring(block(d + b * w) for b in range(local))
        self.pool = Pool(d, pool)
        self.add_module("global", ring([block(d), block(w), block(w)]))
        self.post = linears((d + local * w + w, *post), "tanh", bn)
        self.out = Linear(post[-1], 3, "none", False)

    def before_pool(self, x, tap=lambda name, value: None):
        return self.run(self.pre, "pre", x, None, tap)

    def forward(self, x, graph, contraction, tap=lambda name, value: None):
        g = getattr(self, "global")
        x = self.before_pool(x, tap)
        local = self.dense_module(self.local, "local", x, graph, tap)
        if contraction is None:  # dynamic pooling, as in the paper: pairs from this very pose
            contraction = contract(graph, self.pool.edge_scores(x, graph))
        score = self.pool.score(x, graph, contraction)
        y = self.pool.down(x, score, contraction)
        tap("pool", y), tap("pool.members", contraction.members), tap("pool.score", score)
        for b in (0, 1):
            y = g[b](y, contraction.coarse)
            tap(f"global.{b}", y)
        y = self.pool.up(y, score, contraction)
        tap("unpool", y)
        y = g[2](y, graph)
        tap("global.2", y)
        y = self.run(self.post, "post", torch.cat([local, y], 1), graph, tap)
        y = self.out(y)
        tap("out", y)
        return y


class DenseGATs(Network):
    """T 3.2"""

    def __init__(self, D, pre=(32, 32), modules=3, blocks=6, K=8, Fe=8, B=8, post=(512, 128), gat_bn=True, bn=True):
        super().__init__(D)
        block = lambda d: GAT(d, K, Fe, B, "tanhshrink", gat_bn)
        w, d = K * Fe + B, pre[-1]
        self.pre = linears((D, *pre), "tanh", bn)
        dense, transition = [], []
        for m in range(modules):
            dense.append(ring(block(d + b * w) for b in range(blocks)))
            d += blocks * w
            if m + 1 < modules:
                transition.append(block(d))
                d = w
        self.dense, self.transition = ring(dense), ring(transition)
        self.post = linears((d, *post), "tanh", bn)
        self.out = Linear(post[-1], 3, "none", False)

    def forward(self, x, graph, contraction=None, tap=lambda name, value: None):
        x = self.run(self.pre, "pre", x, graph, tap)
        for m, blocks in enumerate(self.dense):
            x = self.dense_module(blocks, f"dense.{m}", x, graph, tap)
            if m + 1 < len(self.dense):
                x = self.transition[m](x, graph)
                tap(f"transition.{m}", x)
        x = self.out(self.run(self.post, "post", x, graph, tap))
        tap("out", x)
        return x


class Baseline(Network):
    """mlp (only pre), gat (only gat), neuroskinning (pre, gat, post); T Tables 3.3, 3.4"""

    def __init__(self, D, pre=(), gat=0, K=8, Fe=16, post=(), gat_bn=True, bn=True):
        super().__init__(D)
        d = pre[-1] if pre else D
        self.pre = linears((D, *pre), "tanh", bn)
        layers = []
        for _ in range(gat):
            layers.append(GAT(d, K, Fe, 0, "tanh", gat_bn))
            d = K * Fe
        self.gat = ring(layers)
        self.post = linears((d, *post), "tanh", bn)
        self.out = Linear(post[-1] if post else d, 3, "none", False)

    def forward(self, x, graph, contraction=None, tap=lambda name, value: None):
        for name in ("pre", "gat", "post"):
            x = self.run(getattr(self, name), name, x, graph, tap)
        x = self.out(x)
        tap("out", x)
        return x


SIZES = {  # --arch NAME or NAME:SIZE
    "multiresgnet": (MultiResGNet, {}),
    "multiresgnet:lite": (MultiResGNet, dict(K=4, B=64, post=(128, 64))),
    "multiresgnet:humanoid": (MultiResGNet, dict(pre=(128, 64), K=4, B=64, post=(160, 64))),  # the shipped models'
    "multiresgnet:humanoid-small": (MultiResGNet, dict(pre=(64, 32), K=4, Fe=4, B=32, post=(64, 32), pool=8)),
    "multiresgnet:humanoid-lite": (MultiResGNet, dict(pre=(64, 32), K=4, Fe=4, B=16, post=(64, 32), pool=8)),
    "multiresgnet:tiny": (MultiResGNet, dict(pre=(64, 32), K=4, Fe=8, B=32, post=(96, 32), pool=8)),
    "densegats": (DenseGATs, {}),
    "mlp": (Baseline, dict(pre=(256, 512, 512, 128))),
    "gat": (Baseline, dict(gat=4)),
    "neuroskinning": (Baseline, dict(pre=(128,), gat=3, post=(128,))),
}


def create(name, D, **changes):
    """a fresh network: create("multiresgnet:lite", 136)"""
    kind, sizes = SIZES[name]
    net = kind(D, **{**sizes, **changes})
    with torch.no_grad():
        net.out.weight.zero_()  # the first step starts from plain skinning
    return net


def build(arch, tensors):
    """the network a model file holds: every width comes from the tensors' shapes, as deformnet.h does it"""
    t = {k: torch.from_numpy(np.array(v, np.float32)) for k, v in tensors.items() if not k.startswith("golden.")}
    rows = lambda part: [len(t[f"{part}.{b}.weight"]) for b in range(1000) if f"{part}.{b}.weight" in t]
    count = lambda part: len({k.split(".")[len(part.split("."))] for k in t if k.startswith(part + ".")})
    first = "pre.0.weight" if "pre.0.weight" in t else "gat.0.lin.weight"
    probe = next((k[:-len(".att_dst")] for k in t if k.endswith(".att_dst") and not k.startswith("pool")), None)
    sizes = dict(pre=rows("pre"), post=rows("post"), bn=any(k.startswith(("pre", "post")) and ".bn." in k for k in t))
    if probe:
        sizes.update(K=t[probe + ".att_dst"].shape[0], Fe=t[probe + ".att_dst"].shape[1], gat_bn=probe + ".bn.weight" in t)
    if arch == "multiresgnet":
        net = MultiResGNet(t[first].shape[1], local=count("local"), B=len(t[probe + ".self.weight"]),
                           pool=len(t["pool.lin.weight"]), **sizes)
        net.pool.offset = float(t.pop("pool.offset", torch.zeros(1)))
    elif arch == "densegats":
        net = DenseGATs(t[first].shape[1], modules=count("dense"), blocks=count("dense.0"),
                        B=len(t[probe + ".self.weight"]), **sizes)
    elif arch in ("mlp", "gat", "neuroskinning"):
        net = Baseline(t[first].shape[1], gat=count("gat"), **sizes)
    else:
        raise ValueError(f"unknown architecture {arch!r}")
    missing, unexpected = net.load_state_dict(t, strict=False)
    missing = [k for k in missing if not k.startswith(("input.", "output."))]
    if missing or unexpected:
        raise ValueError(f"{arch}: missing {missing}, not used {unexpected}")
    return net.eval()


def narrow(wide, net, batches):
    """net's first weights from those of a wider MultiResGNet, `wide`: of every layer the units that weigh most on what reads
    them stay (heads stay whole), and a unit left out is replaced by its mean. batches: (normalised rows, Graph, Contraction)
    over which means and deviations are taken. Both with batch norm, and with as many heads of the same width"""
    seen, state = {}, {k: v.clone() for k, v in wide.state_dict().items()}
    with torch.no_grad():
        for x, graph, contraction in batches:
            wide.eval()(x, graph, contraction, lambda name, y: seen.setdefault(name, []).append(y))
    seen = {k: torch.cat(v) for k, v in seen.items() if not k.startswith("pool.")}
    at = lambda *names: [(name.split("=")[0], name.split("=")[-1]) for name in names]  # producer, and its values as read
    reads = {f"pre.{b}": at(f"pre.{b - 1}") if b else [] for b in range(len(wide.pre))}
    rows = at(f"pre.{len(wide.pre) - 1}")
    for b in range(len(wide.local)):
        reads[f"local.{b}"], rows = rows, at(f"local.{b}") + rows
    first = f"pre.{len(wide.pre) - 1}"
    reads.update({"pool": at(first), "global.0": at(first + "=pool"), "global.1": at("global.0"), "global.2": at("global.1=unpool"),
                  **{f"post.{b}": at(f"post.{b - 1}") if b else rows + at("global.2") for b in range(len(wide.post))},
                  "out": at(f"post.{len(wide.post) - 1}")})
    matrices = lambda layer: [k for k in (f"{layer}.weight", f"{layer}.lin.weight", f"{layer}.self.weight") if k in state]
    weigh = {p: 0 for p in seen}  # squared effect of each unit's deviations on its readers, in their own deviations
    for layer, inputs in reads.items():
        W = torch.cat([state[k] for k in matrices(layer)])
        if layer + ".bn.weight" in state:
            W = W * (state[layer + ".bn.weight"] * (state[layer + ".bn.running_var"] + EPS).rsqrt())[:, None]
        for (p, values), part in zip(inputs, W.split([seen[p].shape[1] for p, _ in inputs], 1) if inputs else []):
            weigh[p] = weigh[p] + part.square().sum(0) * seen[values].var(0)
    want, keep = net.state_dict(), {}
    for p in reads:
        if p in ("pool", "out"):
            continue
        gat = f"{p}.lin.weight" in state
        heads, total = (len(state[f"{p}.lin.weight"]), len(want[f"{p}.lin.weight"]) + len(want[f"{p}.self.weight"])) if gat \
            else (0, len(want[f"{p}.weight"]))
        best = weigh[p][heads:].argsort(descending=True)[:total - heads].sort()[0]
        keep[p] = torch.cat([torch.arange(heads), heads + best])
    for layer, inputs in reads.items():
        lost, columns, start = 0, [], 0
        for p, values in inputs:
            gone = torch.ones(seen[p].shape[1], dtype=torch.bool)
            gone[keep[p]] = False
            gone = gone.nonzero()[:, 0]
            lost = lost + torch.cat([state[k] for k in matrices(layer)])[:, start + gone] @ seen[values].mean(0)[gone]
            columns.append(start + keep[p])
            start += seen[p].shape[1]
        if inputs and layer + ".bn.running_mean" in state:
            state[layer + ".bn.running_mean"] -= lost
        elif inputs and layer == "out":
            state[layer + ".bias"] += lost
        if inputs:
            for k in matrices(layer):
                state[k] = state[k][:, torch.cat(columns)]
    for p, kept in keep.items():
        heads = len(state[f"{p}.lin.weight"]) if f"{p}.lin.weight" in state else 0
        for k in [k for k in state if k.startswith(p + ".")]:
            if k.endswith((".bias", ".bn.weight", ".bn.running_mean", ".bn.running_var")) or k == f"{p}.weight":
                state[k] = state[k][kept]
            elif k.endswith(".self.weight"):
                state[k] = state[k][kept[heads:] - heads]
    net.load_state_dict(state)


def parameters(net):
    return sum(p.numel() for p in net.parameters())
