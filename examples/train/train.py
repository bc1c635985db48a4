#!/usr/bin/env python3
"""train.py - train a deformation network and write it as a model file for deformnet.h

shows     the whole loop in one place: truth files -> patches of many characters and poses -> network -> model.safetensors
run       make libdeformnet.so
          python3 train.py --characters DIR --truth DIR --out model.safetensors --minutes 60
          ... --processes 2                                 two processes of one thread each, gradients averaged (gloo):
                              on a CPU faster than two threads. torchrun --nproc_per_node 2 train.py ... is the same
                              (Debian 12's torchrun needs "-r 1 -t 1" with its Python)
          the same command again continues from model.safetensors.checkpoint
          ... --start humanoid.safetensors                  goes on from a finished model, on your own characters and truth;
                              a narrower --arch keeps the units that weigh most (nets.narrow)
reads     DIR/*.glb           characters, bound as the header binds them
          DIR/CHARACTER__MOTION.safetensors, written by flesh:  vertices (frames,V,3) metres, palettes (frames,S,3,4),
                              settled (frames): unsettled frames are left out. New files are picked up at every epoch
held out  truth of --hold-characters and of --hold-motions is never trained on; it is what validation measures:
          mean and 99th percentile of the distance to the truth, each divided by plain skinning's, and "rest": of the
          vertices that skinning already places within 0.5 mm, the share that stays within 0.5 mm
writes    OUT (the running average of the weights), OUT.checkpoint, OUT.csv (learning curve) and OUT.png (plotted)

What is learnt: truth - skinned, per welded node, in the axes of deformnet.frame. A batch holds --patches patches of
--nodes nodes, each of another character and pose; a seed node is drawn by how much the nodes of its character move
(--resting is the share drawn evenly). Half of the patches are mirrored, when the skeleton has sides. Nodes within --halo
rings of a patch's border do not count in the loss, their neighbourhood being cut.

Pooling "rest": the pairs follow from the network's own weights on the rest pose, as the header finds them at bind; they
are found again at the start of every epoch, so training follows what inference will do.

Rows are nearly redundant: 65 distances to joints move together, and a bend shows only in small differences between them.
So the first linear layer learns in whitened coordinates (W = U whiten, the inverse square root of the rows' covariance),
where those differences are as large as anything else. The file holds W: nothing changes for the reader.

Batch norm uses the batch's statistics first; for the last part of the run (--freeze) it uses the running ones, as
inference does, while the weights go on learning.

--optimiser soap needs about two thirds of Adam's steps here, for a twentieth more time a step. --leave-joints drops the
distances to joints that hardly move flesh: fingers are 40 of 65 joints, and a thousandth of skinning's error.

The papers' schedule (Adam, rate 1e-3, mean squared error, times 0.75 when the loss has not fallen for eight epochs) is
--schedule plateau --loss mse. The shipped models' commands are in the README and in recipe.sh.
"""
import argparse
import csv
import glob
import math
import os
import socket
import subprocess
import sys
import time

# before numpy loads its BLAS: OpenBLAS takes AVX2 kernels on processors it does not know, and busy-waiting threads
# hurt on a machine that does other work too
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
if os.path.exists("/proc/cpuinfo") and " avx512vl " in open("/proc/cpuinfo").read():
    os.environ.setdefault("OPENBLAS_CORETYPE", "SkylakeX")

import numpy as np
import torch
import torch.distributed as dist
import torch.nn.functional as F

import dn
import nets
import safetensors_io as st

RESTING = 0.0005  # metres: skinning is right there
MOVING = 0.002    # metres: a node that moves this much is drawn half as often as one that moves a lot
FLOOR = 1e-3      # least variance that whitening scales up, of normalised rows


def arguments():
    p = argparse.ArgumentParser(description=__doc__.split("\n")[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    a = p.add_argument
    a("--characters", required=True, help="folder of GLB characters")
    a("--truth", required=True, help="folder of CHARACTER__MOTION.safetensors")
    a("--out", required=True, help="model file to write")
    a("--arch", default="multiresgnet:lite", help=" ".join(nets.SIZES))
    a("--start", default="", help="model file to start from instead of random weights: same architecture, --features and joints; where it "
      "is wider than --arch (multiresgnet) the units that weigh least are left out")
    a("--features", default="relative,normal,geodesic,distance")
    a("--leave-joints", default="", help="comma separated: the network does not see joints whose names contain one of these")
    a("--frame", default="root", choices=["root", "model"])
    a("--hold-characters", default="", help="comma separated names, never trained on")
    a("--hold-motions", default="", help="comma separated names, never trained on")
    a("--minutes", type=float, default=60, help="length of the whole run, over all continuations")
    a("--steps", type=int, default=0, help="length of the run in steps instead, which makes it repeatable")
    a("--patches", type=int, default=8)
    a("--nodes", type=int, default=1536, help="of a patch")
    a("--halo", type=int, default=3)
    a("--even", type=float, default=1.0, help="a character is drawn as often as its number of poses to this power")
    a("--resting", type=float, default=0.25, help="share of patches drawn without regard to motion")
    a("--loss", default="charbonnier", choices=["mse", "huber", "charbonnier"])
    a("--loss-scale", type=float, default=0.001, help="metres: where huber and charbonnier turn from square to linear")
    a("--rate", type=float, default=2e-3)
    a("--optimiser", default="adam", choices=["adam", "soap"])
    a("--schedule", default="cosine", choices=["cosine", "plateau"])
    a("--clip", type=float, default=1.0, help="largest norm of a step's gradient")
    a("--freeze", type=float, default=0.7, help="share of the run after which batch norm's statistics stay fixed")
    a("--average", type=float, default=0.999, help="of the running average of weights, per step")
    a("--epoch", type=int, default=400, help="steps between looks at the truth folder")
    a("--validate", type=float, default=4, help="minutes between validations")
    a("--validate-frames", type=int, default=5, help="of each held-out file")
    a("--seed", type=int, default=1)
    a("--threads", type=int, default=0, help="0: all cores, one with torchrun")
    a("--processes", type=int, default=1, help="start this many and average their gradients")
    a("--licence", default="MIT OR Unlicense")
    a("--cache", default="", help="folder for geodesic distances, default: next to the truth")
    return p.parse_args()


# ------------------------------------------------------------------------------------------------ data
class Clip:
    """the poses of one truth file"""

    def __init__(self, path, character, motion):
        tensors, _ = st.load(path)
        self.character, self.motion = character, motion
        self.vertices, self.palettes = tensors["vertices"], np.array(tensors["palettes"], np.float32)
        settled = np.asarray(tensors.get("settled", np.ones(len(self.vertices)))) != 0
        self.frames = np.flatnonzero(settled)

    def pose(self, frame, **more):
        c, p = self.character, self.palettes[frame].reshape(-1, 12)
        return dn.Pose(c, p, self.vertices[frame], **more)


class Truth:
    """all clips, those to train on and those held out; characters are bound when first met"""

    def __init__(self, o):
        self.o, self.seen, self.characters, self.joints = o, set(), {}, None
        self.train, self.held = [], []
        self.least = 0  # nodes of a patch, once that is settled
        self.hold_characters = set(filter(None, o.hold_characters.split(",")))
        self.hold_motions = set(filter(None, o.hold_motions.split(",")))
        self.cache = o.cache or os.path.join(o.truth, "cache")
        self.scan()

    def character(self, name):
        if name not in self.characters:
            path, leave = os.path.join(self.o.characters, name + ".glb"), list(filter(None, self.o.leave_joints.split(",")))
            if not self.joints:  # the first character's order is the model's
                self.joints = [j for j in dn.Glb(path).joints() if not any(part in j for part in leave)]
            c = dn.Character(path, self.joints, cache=self.cache)
            self.characters[name] = c
            c.moves, c.poses = np.zeros(c.nodes), 0  # sum of squared displacements, for drawing seeds
        return self.characters[name]

    def scan(self):
        """read what is new; files being written have other names"""
        for path in sorted(glob.glob(os.path.join(self.o.truth, "*__*.safetensors"))):
            if path in self.seen:
                continue
            self.seen.add(path)
            name, motion = os.path.basename(path)[:-len(".safetensors")].split("__", 1)
            clip = Clip(path, self.character(name), motion)
            if not len(clip.frames):
                continue
            if self.least and clip.character.nodes < self.least:
                print(f"{path}: fewer nodes than a patch, left out", flush=True)
                continue
            held = (name in self.hold_characters) + 2 * (motion in self.hold_motions)
            if held:
                clip.group = ("", "new character", "new motion", "new character and motion")[held]
                self.held.append(clip)
                continue
            self.train.append(clip)
            some = clip.frames[::max(1, len(clip.frames) // 4)]
            clip.character.poses += len(clip.frames)
            for f in some:
                _, delta = clip.character.displacement(clip.palettes[f], clip.vertices[f])
                clip.character.moves += np.square(delta).sum(1) * (len(clip.frames) / len(some))
        if not self.train:
            raise SystemExit(f"{self.o.truth}: no CHARACTER__MOTION.safetensors to train on")
        for c in self.characters.values():
            rms = np.sqrt(c.moves / max(1, c.poses))
            often = rms / (rms + MOVING) if rms.any() else np.ones(c.nodes)  # of a character at rest only: evenly
            c.draw = np.cumsum(often / often.sum())
        self.poses = sum(len(c.frames) for c in self.train)
        often = [len(c.frames) * c.character.poses ** (self.o.even - 1) for c in self.train]
        self.often = np.cumsum(often) / sum(often)

    def draw(self, rng, patches):
        """random poses with random seeds"""
        out = []
        for _ in range(patches):
            clip = self.train[min(int(np.searchsorted(self.often, rng.random())), len(self.train) - 1)]
            c, frame = clip.character, clip.frames[rng.integers(len(clip.frames))]
            even = rng.random() < self.o.resting
            seed = int(rng.integers(c.nodes)) if even else min(int(np.searchsorted(c.draw, rng.random())), c.nodes - 1)
            mirror = c.mirror is not None and rng.random() < 0.5
            out.append(clip.pose(frame, seed=seed, mirror=int(mirror), random=int(rng.integers(1, 2**62))))
        return out


def tensors(batch, device):
    """a batch of dn.make_batch -> rows, graph, contraction, target, use"""
    t = {k: torch.from_numpy(v) for k, v in batch.items() if k != "node"}
    graph = nets.Graph(t["table"], t["degree"], t["offset"]).to(device)
    contraction = nets.Contraction(t["members"], t["slot"], t["cluster"],
                                   nets.Graph(t["coarse_table"], t["coarse_degree"], t["coarse_offset"])).to(device) \
        if "members" in t else None
    return t["rows"].to(device), graph, contraction, t["target"].to(device), t["use"].to(device)


# ------------------------------------------------------------------------------------------------ training
class Soap:
    """Adam in the eigenbasis of each matrix's gradients (Vyas et al. 2024, SOAP): with L and R the running means of G G'
    and G' G, the axes are their eigenvectors, refreshed by one step of subspace iteration. What is not a matrix of more
    than `least` rows and columns is left to plain Adam. Sees the gradients that all processes share, so all stay equal"""

    def __init__(self, params, lr, betas=(0.9, 0.99), eps=1e-8, every=10, least=8):
        self.params, self.betas, self.eps, self.every, self.least = list(params), betas, eps, every, least
        self.param_groups, self.steps, self.state = [{"lr": lr}], 0, {}

    def matrix(self, p):
        return p.dim() == 2 and min(p.shape) > self.least

    def axes(self, s):
        for side, power in (("L", s["GGt"]), ("R", s["GtG"])):
            s[side] = torch.linalg.qr(power @ s[side])[0] if side in s else torch.linalg.eigh(power)[1].flip(1).contiguous()

    @torch.no_grad()
    def step(self):
        (b1, b2), rate = self.betas, self.param_groups[0]["lr"]
        self.steps += 1
        scale = rate * math.sqrt(1 - b2 ** self.steps) / (1 - b1 ** self.steps)
        for k, p in enumerate(self.params):
            g, first = p.grad, k not in self.state
            s = self.state.setdefault(k, {})
            if first:
                s["m"], s["v"] = torch.zeros_like(g), torch.zeros_like(g)
                if self.matrix(p):
                    s["GGt"], s["GtG"] = g.new_zeros(len(g), len(g)), g.new_zeros(g.shape[1], g.shape[1])
            s["m"].lerp_(g, 1 - b1)
            m = s["m"]
            if self.matrix(p):
                s["GGt"].lerp_(g @ g.T, 1 - b2)
                s["GtG"].lerp_(g.T @ g, 1 - b2)
                if first or self.steps % self.every == 0:
                    self.axes(s)
                g, m = s["L"].T @ g @ s["R"], s["L"].T @ m @ s["R"]
            s["v"].lerp_(g * g, 1 - b2)
            update = m / (s["v"].sqrt() + self.eps)
            p.sub_(s["L"] @ update @ s["R"].T if self.matrix(p) else update, alpha=scale)

    def state_dict(self):
        return {"steps": self.steps, "state": self.state}

    def load_state_dict(self, d):
        self.steps, self.state = d["steps"], d["state"]


class Trainer:
    def __init__(self, o):
        self.o, self.rank, self.world = o, int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
        self.device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", 0))) if torch.cuda.is_available() else \
            torch.device("cpu")
        torch.set_num_threads(o.threads or (1 if self.world > 1 else len(os.sched_getaffinity(0))))
        if self.world > 1:
            dist.init_process_group("gloo")
        self.features, self.root = o.features.split(","), o.frame == "root"
        self.truth = Truth(o)
        self.width = max(c.degree for c in self.truth.characters.values())
        self.nodes = self.truth.least = min([o.nodes] + [c.nodes for c in self.truth.characters.values()])
        self.rng = np.random.default_rng([o.seed, self.rank])
        torch.manual_seed(o.seed)
        D = dn.row_width(self.features, len(self.truth.joints))
        self.net = nets.create(o.arch, D)
        self.measure()
        if o.start:
            self.start(o.start)
        self.net.to(self.device).train()
        self.flatten()
        self.step, self.elapsed, self.best, self.waited, self.rate = 0, 0.0, math.inf, 0, o.rate
        self.resume()
        self.average = nets.create(o.arch, D).to(self.device).eval()
        self.average.load_state_dict(self.saved_average if hasattr(self, "saved_average") else self.net.state_dict())
        self.averaged = torch.cat([p.data.reshape(-1) for p in self.average.parameters()])
        self.view(self.average, self.averaged)
        self.set_whiten(self.net, self.average)

    def start(self, path):
        """a finished model as the first weights, with the scales it was trained with"""
        file, meta = st.load(path)
        if meta["deformnet.features"] != self.o.features or meta["deformnet.joints"] != ",".join(self.truth.joints):
            raise SystemExit(f"{path}: made for other features or joints than this run's")
        arch = self.o.arch.split(":")[0]
        if meta["deformnet.arch"] != arch:
            raise SystemExit(f"{path} is of {meta['deformnet.arch']}, not of {arch}")
        first, own = nets.build(arch, file), self.net.state_dict()
        stats = getattr(first, "input")
        self.scale = np.stack([stats.mean.numpy(), 1 / stats.std.numpy()]).astype(np.float32)
        if any(len(v) != len(own[k]) for k, v in first.state_dict().items() if v.dim()):
            self.find_pairs(first, {c.character.name: c.character for c in self.truth.train}.values())
            rng, batches = np.random.default_rng(self.o.seed), []
            for _ in range(24):
                b = dn.make_batch(self.truth.draw(rng, 16), self.features, self.root, self.nodes, 0, self.scale, True, self.width)
                batches.append(tensors(b, "cpu")[:3])
            nets.narrow(first, self.net, batches)
            first = self.net
        state = {k: v.clone() for k, v in first.state_dict().items()}
        if self.whiten is not None and self.world > 1:
            dist.broadcast(self.whiten, 0)
        if self.whiten is not None:  # U = W whiten^-1, so that the first layer computes what it did
            state["pre.0.weight"] = (state["pre.0.weight"].double() @ torch.inverse(self.whiten.double())).float()
        self.net.load_state_dict(state)
        self.say(f"starting from {path}")

    def say(self, *text):
        if self.rank == 0:
            print(*text, flush=True)

    def view(self, net, flat, grad=None):
        """all parameters as pieces of one vector: one optimiser step, one all-reduce, one running average"""
        at = 0
        for p in net.parameters():
            p.data = flat[at:at + p.numel()].view_as(p)
            if grad is not None:
                p.grad = grad[at:at + p.numel()].view_as(p)
            at += p.numel()

    def flatten(self):
        flat = torch.cat([p.data.reshape(-1) for p in self.net.parameters()])
        self.flat, self.grad = torch.nn.Parameter(flat), torch.zeros(len(flat) + 1, device=self.device)
        self.flat.grad = self.grad[:-1]  # the last number carries progress, so that all processes agree on it
        self.view(self.net, self.flat.data, self.flat.grad)
        self.optimiser = Soap(self.net.parameters(), self.o.rate) if self.o.optimiser == "soap" else \
            torch.optim.Adam([self.flat], lr=self.o.rate)

    def measure(self):
        """input.mean and .std over the training set, output.std: the root mean square of the moving patches"""
        rng, rows, target = np.random.default_rng(self.o.seed), [], []
        for _ in range(24):
            b = dn.make_batch(self.truth.draw(rng, 16), self.features, self.root, 512, 0, None, False, self.width)
            rows.append(b["rows"])
            target.append(b["target"])
        rows, target = np.concatenate(rows).astype(float), np.concatenate(target).astype(float)
        stats, out = getattr(self.net, "input"), self.net.output
        stats.mean.copy_(torch.from_numpy(rows.mean(0)))
        stats.std.copy_(torch.from_numpy(rows.std(0).clip(1e-3)))
        out.std.fill_(float(np.sqrt(np.square(target).mean())))
        if self.world > 1:  # one process may have seen a file that another did not
            for t in self.net.state_dict().values():
                dist.broadcast(t, 0)
        self.scale = np.stack([stats.mean.numpy(), 1 / stats.std.numpy()]).astype(np.float32)
        if len(self.net.pre):
            value, vector = np.linalg.eigh(np.cov((rows - rows.mean(0)) * self.scale[1], rowvar=False))
            self.whiten = torch.from_numpy((vector / np.sqrt(value.clip(FLOOR)) @ vector.T).astype(np.float32))

    whiten = None

    def set_whiten(self, *nets):
        if self.whiten is not None:
            self.whiten = self.whiten.to(self.device)
            if self.world > 1:
                dist.broadcast(self.whiten, 0)
            for net in nets:
                net.pre[0].whiten = self.whiten

    def find_pairs(self, net, characters):
        """the contraction of each rest mesh under the network's present weights"""
        if not net.pools:
            return
        mode = net.training
        net.eval()
        with torch.no_grad():
            for c in characters:
                x = torch.from_numpy(self.rest_batch(c)["rows"]).to(self.device)
                c.contract(net.pool.ds(net.before_pool(x)).cpu().numpy())
        net.train(mode)

    def rest_batch(self, c):
        rest = np.tile(np.eye(3, 4, dtype=np.float32).reshape(1, 12), (len(c.joint_names), 1))
        return dn.make_batch([dn.Pose(c, rest)], self.features, self.root, None, 0, self.scale, False, self.width)

    def loss(self, y, target, use):
        """per node, in units of output.std; unused nodes weigh nothing"""
        square, s = (y - target / self.net.output.std).square().sum(1), self.o.loss_scale / float(self.net.output.std[0])
        if self.o.loss == "mse":
            each = square
        elif self.o.loss == "charbonnier":
            each = (square + s * s).sqrt() - s
        else:
            root = (square + 1e-12).sqrt()
            each = torch.where(root < s, 0.5 * square / s, root - 0.5 * s)
        return (each * use).sum() / use.sum()

    def rates(self, progress):
        o = self.o
        rate = self.rate
        if o.schedule == "cosine":
            rate = o.rate * (0.5 + 0.5 * math.cos(math.pi * min(1, progress))) + 1e-6
        rate *= min(1, (self.step + 1) / 50)  # warm-up
        for g in self.optimiser.param_groups:
            g["lr"] = rate
        for m in self.net.modules():
            if isinstance(m, nets.BatchNorm):
                m.frozen = progress > o.freeze
        return rate

    def train(self):
        o, start, shown, validated = self.o, time.time() - self.elapsed, time.time(), time.time()
        self.say(f"{o.arch}: {nets.parameters(self.net):,} parameters, {self.truth.poses} poses in {len(self.truth.train)} files, "
                 f"{len(self.truth.held)} held out, {self.world} x {torch.get_num_threads()} threads, "
                 f"{'kernels.c' if nets.C else 'plain PyTorch'}, rms displacement {100 * float(self.net.output.std[0]):.2f} cm")
        progress, total, count, done, pieces = self.step / o.steps if o.steps else self.elapsed / (60 * o.minutes), 0.0, 0, 0, [0.0] * 3
        if self.step == 0:
            self.validate(0.0, math.nan)
        while progress < 1:
            if self.step % o.epoch == 0 or count == 0 and done == 0:
                self.epoch(total / max(count, 1), count)
                total, count = 0.0, 0
            rate = self.rates(progress)
            t0 = time.time()
            batch = dn.make_batch(self.truth.draw(self.rng, o.patches), self.features, self.root, self.nodes, o.halo, self.scale,
                                  bool(self.net.pools), self.width)
            x, graph, contraction, target, use = tensors(batch, self.device)
            t1 = time.time()
            self.grad.zero_()
            loss = self.loss(self.net(x, graph, contraction), target, use)
            t2 = time.time()
            loss.backward()
            self.grad[-1] = (self.step + 1) / o.steps if o.steps else (time.time() - start) / (60 * o.minutes)
            if self.world > 1:
                dist.all_reduce(self.grad)
                self.grad /= self.world
            progress = float(self.grad[-1])
            norm = float(self.flat.grad.norm())
            if math.isfinite(norm):
                self.flat.grad.mul_(min(1.0, o.clip / (norm + 1e-12)))
                self.optimiser.step()
            self.step += 1
            keep = min(o.average, (1 + self.step) / (10 + self.step))
            with torch.no_grad():
                self.averaged.lerp_(self.flat.data, 1 - keep)
                for a, b in zip(self.average.buffers(), self.net.buffers()):
                    a.lerp_(b, 1 - keep)
            value = float(loss)
            total, count, done = total + value, count + 1, done + len(x) * self.world
            pieces = [p + d for p, d in zip(pieces, (t1 - t0, t2 - t1, time.time() - t2))]
            now = time.time()
            self.elapsed = now - start
            if now - shown > 20:
                speed, done, n = done / (now - shown), 0, sum(pieces)
                left = max(0.0, self.elapsed / 60 / max(progress, 1e-6) * (1 - progress))
                self.say(f"step {self.step}  loss {total / count:.4f}  gradient {norm:.2f}  rate {rate:.1e}  {speed:,.0f} vertices/s  "
                         f"(batch {pieces[0] / n:.0%}, forward {pieces[1] / n:.0%}, backward {pieces[2] / n:.0%})  {left:.1f} min left")
                shown, pieces = now, [0.0] * 3
            if self.rank == 0 and now - validated > 60 * o.validate:  # others wait in their next all-reduce
                self.validate(self.elapsed / 60, total / count)
                validated = shown = time.time()
                done = 0
        self.validate(self.elapsed / 60, total / max(count, 1), every=1)
        self.say(f"done: {o.out}")

    def epoch(self, loss, count):
        """new truth, new pairs; the papers' plateau rule"""
        self.truth.scan()
        self.width = max(self.width, max(c.degree for c in self.truth.characters.values()))
        if self.world > 1:
            for b in self.net.buffers():
                dist.all_reduce(b)
                b /= self.world
        self.find_pairs(self.net, {c.character.name: c.character for c in self.truth.train}.values())
        if count:
            self.waited = 0 if loss < 0.999 * self.best else self.waited + 1
            self.best = min(self.best, loss)
            if self.waited > 8:
                self.rate, self.waited = max(5e-7, 0.75 * self.rate), 0

    # -------------------------------------------------------------------------------------------- validation
    def errors(self, net, clip, frames):
        """distances to the truth in metres of skinned and refined nodes, (frames*N) each"""
        plain, refined, c = [], [], clip.character
        for f in frames:
            b = dn.make_batch([clip.pose(f)], self.features, self.root, None, 0, self.scale, bool(net.pools), self.width)
            x, graph, contraction, target, _ = tensors(b, self.device)
            with torch.no_grad():
                y = net(x, graph, contraction) * net.output.std + net.output.mean
            plain.append(target.norm(dim=1).cpu().numpy())
            refined.append((y - target).norm(dim=1).cpu().numpy())
        return np.concatenate(plain), np.concatenate(refined)

    def validate(self, minutes, loss, every=None):
        """figures of the averaged network on what was held out, and on a few training poses; writes all files"""
        if self.rank:
            return
        o, groups, line = self.o, {}, {}
        clips = [(c.group, c) for c in self.truth.held] + [("seen", c) for c in self.truth.train[:: max(1, len(self.truth.train) // 6)][:6]]
        self.find_pairs(self.average, {c.character.name: c.character for _, c in clips}.values())
        for group, clip in clips:
            wanted = o.validate_frames if group != "seen" else 2
            step = max(1, -(-len(clip.frames) // wanted)) if every is None or group == "seen" else every
            groups.setdefault(group, []).append(self.errors(self.average, clip, clip.frames[::step]))
        for group, parts in groups.items():
            a, b = (np.concatenate([p[k] for p in parts]) for k in (0, 1))
            rest = a < RESTING
            worse = max((q.mean() / p.mean() for p, q in parts if p.any()), default=0)
            line[group] = (b.mean() / a.mean(), np.percentile(b, 99) / np.percentile(a, 99), float((b[rest] < RESTING).mean()))
            self.say(f"   {group}: skinning mean {100 * a.mean():.3f} cm, 99 % {100 * np.percentile(a, 99):.2f}; refined "
                     f"{line[group][0]:.3f} and {line[group][1]:.3f} of it; rest kept {line[group][2]:.1%}; worst clip {worse:.2f}")
        # the training characters share their pairs with validation: give them back
        self.find_pairs(self.net, {c.character.name: c.character for g, c in clips if g in ("seen", "new motion")}.values())
        row = {"minutes": round(minutes, 2), "step": self.step, "poses": self.truth.poses, "loss": loss}
        for g, v in line.items():
            row.update({f"{g} mean": v[0], f"{g} p99": v[1], f"{g} rest": v[2]})
        self.curve(row)
        if self.step:
            self.export()
            self.checkpoint()

    def curve(self, row):
        path, rows = self.o.out + ".csv", []
        if os.path.exists(path) and self.step:
            rows = list(csv.DictReader(open(path)))
        rows.append({k: str(v) for k, v in row.items()})
        keys = list(dict.fromkeys(k for r in rows for k in r))
        with open(path + ".part", "w", newline="") as f:
            w = csv.DictWriter(f, keys)
            w.writeheader()
            w.writerows(rows)
        os.replace(path + ".part", path)
        try:
            import matplotlib
        except ImportError:
            return
        matplotlib.use("Agg")
        import matplotlib.pyplot as plt
        fig, axes = plt.subplots(1, 3, figsize=(15, 4.5))
        number = lambda r, k: float(r.get(k) or "nan")
        for ax, what in zip(axes, ("mean", "p99", "rest")):
            for k in keys:
                if k.endswith(" " + what):
                    ax.plot([number(r, "minutes") for r in rows], [number(r, k) for r in rows], label=k[:-len(what) - 1])
            ax.set_xlabel("minutes")
            ax.set_title({"mean": "mean error / skinning's", "p99": "99th percentile / skinning's",
                          "rest": "resting vertices kept within 0.5 mm"}[what])
            ax.grid(alpha=0.3)
            ax.set_ylim(0, 1.2 if what != "rest" else 1.0)
        axes[0].legend()
        fig.tight_layout()
        fig.savefig(self.o.out + ".png", dpi=90)
        plt.close(fig)

    # -------------------------------------------------------------------------------------------- files
    def export(self):
        """the averaged network as deformnet.h loads it"""
        o, chars = self.o, sorted({c.character.name for c in self.truth.train})
        own = [c for c in chars if "_warp_" not in c]  # warp.py's names
        warped = len(chars) - len(own)
        meta = {"deformnet.version": "1", "deformnet.arch": o.arch.split(":")[0], "deformnet.features": o.features,
                "deformnet.frame": o.frame, "deformnet.joints": ",".join(self.truth.joints), "deformnet.unit": "1",
                "deformnet.licence": o.licence,
                "deformnet.trained_on": f"{self.truth.poses} simulated poses of {len(chars) - warped} characters ({' '.join(own)}) and "
                                        f"{warped} warped copies, {self.elapsed / 60:.0f} minutes, {self.step} steps, seed {o.seed}"}
        if self.net.pools:
            meta["deformnet.pooling"] = "rest"
        tensors = {k: v.detach().cpu() for k, v in self.average.state_dict().items()}
        if self.whiten is not None:
            tensors["pre.0.weight"] = tensors["pre.0.weight"] @ self.whiten.cpu()
        st.save(o.out, {k: v.numpy() for k, v in tensors.items()}, meta)

    def checkpoint(self):
        path = self.o.out + ".checkpoint"
        torch.save({"arch": self.o.arch, "features": self.o.features, "whiten": self.whiten, "net": self.net.state_dict(),
                    "average": self.average.state_dict(), "optimiser": self.optimiser.state_dict(), "step": self.step,
                    "elapsed": self.elapsed, "plateau": (self.best, self.waited, self.rate), "joints": self.truth.joints},
                   path + ".part")
        os.replace(path + ".part", path)

    def resume(self):
        path = self.o.out + ".checkpoint"
        if not os.path.exists(path):
            return
        c = torch.load(path, map_location="cpu")
        if (c["arch"], c["features"], c["joints"]) != (self.o.arch, self.o.features, self.truth.joints):
            raise SystemExit(f"{path} is of {c['arch']} with {c['features']}: remove it, or write to another --out")
        self.net.load_state_dict(c["net"])  # copies into the pieces of self.flat
        self.whiten = c["whiten"]
        self.optimiser.load_state_dict(c["optimiser"])
        self.step, self.elapsed, (self.best, self.waited, self.rate) = c["step"], c["elapsed"], c["plateau"]
        self.saved_average = c["average"]
        self.rng = np.random.default_rng([self.o.seed, self.rank, self.step])
        stats = getattr(self.net, "input")
        self.scale = np.stack([stats.mean.cpu().numpy(), 1 / stats.std.cpu().numpy()]).astype(np.float32)
        self.say(f"continuing {path}: step {self.step}, {self.elapsed / 60:.1f} minutes so far")


def launch(processes):
    """this very command once for each rank, as torchrun would"""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    rank = lambda k: dict(os.environ, RANK=str(k), LOCAL_RANK=str(k), WORLD_SIZE=str(processes), MASTER_ADDR="127.0.0.1",
                          MASTER_PORT=str(port))
    running = [subprocess.Popen([sys.executable, *sys.argv], env=rank(k)) for k in range(processes)]
    while all(p.poll() is None for p in running):
        time.sleep(0.5)
    if any(p.poll() for p in running):  # one failed: the others would wait for it for ever
        for p in running:
            p.terminate()
    return max(abs(p.wait()) for p in running)


if __name__ == "__main__":
    options = arguments()
    if options.processes > 1 and "RANK" not in os.environ:
        sys.exit(launch(options.processes))
    Trainer(options).train()
