"""humanoid_mesh.py - an even triangle mesh on the zero set of a mirror-symmetric field

flow      field --surface_nets, half a body--> fine mesh --remesh: split, collapse, flip, relax--> even triangles
          --mirror--> closed mesh, the same vertex for vertex left and right
papers    Gibson, Constrained elastic surface nets, MICCAI 1998; Botsch and Kobbelt, A remeshing approach to
          multiresolution modeling, SGP 2004
"""
import numpy as np
from humanoid_field import HAND_H, JOINT, MIRROR

# ------------------------------------------------------------------------------------------------ surface nets
def untangle(field):
    """a grid face whose corners alternate in, out, in, out would make an edge of four triangles: where one does (a
    tube just grazing the grid) the corner nearest the surface changes side. Moves the surface by less than a cell,
    and the vertices are put back onto the exact field later"""
    for _ in range(20):
        found = 0
        for a, b in ((0, 1), (0, 2), (1, 2)):
            v = np.moveaxis(field, (a, b), (0, 1))                 # a view: writing to it changes the field
            c = [v[:-1, :-1], v[1:, :-1], v[1:, 1:], v[:-1, 1:]]
            s = [x < 0 for x in c]
            bad = np.argwhere((s[0] == s[2]) & (s[1] == s[3]) & (s[0] != s[1]))
            found += len(bad)
            for i, j, k in bad:
                four = [(i, j, k), (i + 1, j, k), (i + 1, j + 1, k), (i, j + 1, k)]
                q = min(four, key=lambda t: abs(v[t]))
                v[q] = -np.copysign(np.float32(1e-6), v[q])
        if not found:
            return
    raise SystemExit("the grid is too coarse for the fingers")


def surface_nets(body, cell=.005):
    """half the body (x >= 0) as quads split in two: one vertex in each cell the surface crosses (mean of the edge
    crossings), one quad round each crossed grid edge. Grid points lie at (i - 1/2) cell, so the first layer of
    cells straddles the mirror plane and its vertices get x = 0"""
    lo, hi = np.array((-cell / 2, -4.5 * cell, -.20)), np.array((.66, 1.76, .40))
    n = np.ceil((hi - lo) / cell).astype(int) + 1
    n += -n % 4 + 1
    c = 4                                                          # coarse pass: every fourth point
    cn = (n - 1) // c + 1
    idx = np.stack(np.meshgrid(*[np.arange(k) for k in cn], indexing="ij"), -1).reshape(-1, 3)
    coarse = body.f(lo + idx * c * cell).reshape(cn)
    near = np.abs(coarse) < 1.3 * c * cell
    block = np.zeros(cn - 1, bool)
    for i in range(8):
        o = [(i >> k) & 1 for k in range(3)]
        block |= near[o[0]:cn[0] - 1 + o[0], o[1]:cn[1] - 1 + o[1], o[2]:cn[2] - 1 + o[2]]
    up = lambda a: a.repeat(c, 0).repeat(c, 1).repeat(c, 2)
    field = np.where(up(coarse)[:n[0], :n[1], :n[2]] < 0, -1.0, 1.0).astype(np.float32)
    todo = np.zeros(n, bool)
    fine = up(block)
    for i in range(8):
        o = [(i >> k) & 1 for k in range(3)]
        todo[o[0]:n[0] - 1 + o[0], o[1]:n[1] - 1 + o[1], o[2]:n[2] - 1 + o[2]] |= fine
    q = np.argwhere(todo)
    field[todo] = np.concatenate([body.f(lo + part * cell) for part in np.array_split(q, len(q) // 40000 + 1)])

    untangle(field)
    m = n - 1                                                      # cells
    total, count = np.zeros(tuple(m) + (3,)), np.zeros(m)
    for axis in range(3):
        a = np.moveaxis(field, axis, 0)
        cross = (a[:-1] < 0) != (a[1:] < 0)
        e = np.argwhere(cross)
        f0, f1 = a[:-1][cross], a[1:][cross]
        t = f0 / (f0 - f1)
        other = [k for k in range(3) if k != axis]
        at = np.zeros((len(e), 3), int)
        at[:, axis], at[:, other[0]], at[:, other[1]] = e[:, 0], e[:, 1], e[:, 2]
        pos = at.astype(float)
        pos[:, axis] += t
        for d0 in (0, 1):
            for d1 in (0, 1):
                k = at.copy()
                k[:, other[0]] -= d0
                k[:, other[1]] -= d1
                ok = ((k >= 0) & (k < m)).all(1)
                np.add.at(total, tuple(k[ok].T), pos[ok])
                np.add.at(count, tuple(k[ok].T), 1)
    ids = np.full(m, -1)
    has = np.argwhere(count > 0)
    ids[tuple(has.T)] = np.arange(len(has))
    verts = lo + total[tuple(has.T)] / count[tuple(has.T)][:, None] * cell
    verts[has[:, 0] == 0, 0] = 0
    faces = []
    for axis in range(3):
        a = np.moveaxis(field, axis, 0)
        e = np.argwhere((a[:-1] < 0) != (a[1:] < 0))
        o0, o1 = (axis + 1) % 3, (axis + 2) % 3
        other = [k for k in range(3) if k != axis]
        at = np.zeros((len(e), 3), int)
        at[:, axis], at[:, other[0]], at[:, other[1]] = e[:, 0], e[:, 1], e[:, 2]
        inside = field[tuple(at.T)] < 0
        quad = []
        for d0, d1 in ((0, 0), (1, 0), (1, 1), (0, 1)):
            k = at.copy()
            k[:, o0] -= 1 - d0
            k[:, o1] -= 1 - d1
            quad.append(np.where((k >= 0).all(1), ids[tuple(np.maximum(k, 0).T)], -1))
        quad = np.stack(quad, 1)
        quad[~inside] = quad[~inside][:, ::-1]
        faces.append(quad[(quad >= 0).all(1)])
    q = np.vstack(faces)
    apart = lambda i, j: np.linalg.norm(verts[q[:, i]] - verts[q[:, j]], axis=1)
    tri = np.where((apart(0, 2) < apart(1, 3))[:, None], q[:, [0, 1, 2, 0, 2, 3]], q[:, [1, 2, 3, 1, 3, 0]])
    return verts, tri.reshape(-1, 3)


# ------------------------------------------------------------------------------------------------ remeshing
class Mesh:
    """triangle mesh with a border, edited edge by edge (after Botsch and Kobbelt 2004): edges longer than 4/3 of the
    wanted length split, shorter than 4/5 collapse, flips even out valences, vertices relax in the tangent plane"""

    def __init__(self, verts, tris):
        self.p = [tuple(v) for v in verts]
        self.t = [tuple(int(i) for i in t) for t in tris]
        self.vf = [set() for _ in self.p]
        for i, t in enumerate(self.t):
            for v in t:
                self.vf[v].add(i)

    def ring(self, v):
        r = set()
        for f in self.vf[v]:
            r.update(self.t[f])
        r.discard(v)
        return r

    def edges(self):
        t = np.array([t for t in self.t if t is not None])
        e = np.sort(np.vstack([t[:, :2], t[:, 1:], t[:, [2, 0]]]), axis=1)
        return np.unique(e, axis=0)

    def border(self, v):
        return self.p[v][0] == 0.0

    def replace(self, f, a, b):
        self.t[f] = tuple(b if x == a else x for x in self.t[f])

    def lengths(self, e):
        p = np.array(self.p)
        return np.linalg.norm(p[e[:, 0]] - p[e[:, 1]], axis=1)

    def split(self, want):
        """long edges, and those across the body from border to border, which its mirror image would double"""
        e = self.edges()
        ratio = self.lengths(e) / ((want[e[:, 0]] + want[e[:, 1]]) / 2)
        for k, (a, b) in enumerate(e):
            if self.border(a) and self.border(b) and len(self.vf[a] & self.vf[b]) == 2:
                ratio[k] = 1e9
        done = 0
        for k in np.argsort(-ratio, kind="stable"):
            if ratio[k] < 4 / 3:
                break
            a, b = (int(x) for x in e[k])
            fs = self.vf[a] & self.vf[b]
            if not fs:
                continue
            m = len(self.p)
            pa, pb = self.p[a], self.p[b]
            x = 0.0 if len(fs) == 1 else max((pa[0] + pb[0]) / 2, 5e-4)
            self.p.append((x, (pa[1] + pb[1]) / 2, (pa[2] + pb[2]) / 2))
            self.vf.append(set())
            for f in sorted(fs):
                t = self.t[f]
                c = next(x for x in t if x != a and x != b)
                g = len(self.t)
                self.t.append(tuple(m if x == a else x for x in t))          # keeps b
                self.replace(f, b, m)                                        # keeps a
                self.vf[b].discard(f)
                self.vf[b].add(g)
                self.vf[c].add(g)
                self.vf[m].update((f, g))
            done += 1
        return done

    def normal(self, a, b, c):
        ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
        return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx

    def turns(self, f, v, q):
        """would moving corner v of face f to q turn its normal by more than about 60 degrees"""
        c = [self.p[x] for x in self.t[f]]
        n = self.normal(*c)
        c[self.t[f].index(v)] = q
        m = self.normal(*c)
        d = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
        return d <= 0 or d * d < .25 * (n[0] ** 2 + n[1] ** 2 + n[2] ** 2) * (m[0] ** 2 + m[1] ** 2 + m[2] ** 2)

    def collapse(self, want):
        e = self.edges()
        ratio = self.lengths(e) / ((want[e[:, 0]] + want[e[:, 1]]) / 2)
        done, limit = 0, 4 / 3
        moved = set()
        for k in np.argsort(ratio, kind="stable"):
            if ratio[k] > 4 / 5:
                break
            a, b = (int(x) for x in e[k])
            if a in moved or b in moved:
                continue
            fs = self.vf[a] & self.vf[b]
            if not fs:
                continue
            ba, bb = self.border(a), self.border(b)
            if ba and bb and len(fs) != 1:
                continue
            ra, rb = self.ring(a), self.ring(b)
            if len(ra & rb) != len(fs):
                continue
            if ba != bb and any(self.border(v) for v in (rb - ra if ba else ra - rb) - {a, b}):
                continue
            pa, pb = self.p[a], self.p[b]
            q = pa if ba and not bb else pb if bb and not ba else tuple((x + y) / 2 for x, y in zip(pa, pb))
            far = (limit * want[a]) ** 2
            if any((q[0] - self.p[v][0]) ** 2 + (q[1] - self.p[v][1]) ** 2 + (q[2] - self.p[v][2]) ** 2 > far
                   for v in (ra | rb) - {a, b}):
                continue
            if any(self.turns(f, a, q) for f in self.vf[a] - fs) or any(self.turns(f, b, q) for f in self.vf[b] - fs):
                continue
            for f in fs:
                for v in self.t[f]:
                    self.vf[v].discard(f)
                self.t[f] = None
            for f in self.vf[b]:
                self.replace(f, b, a)
            self.vf[a] |= self.vf[b]
            self.vf[b] = set()
            self.p[a] = q
            moved.add(a)
            done += 1
        return done

    def flip(self):
        done = 0
        val = [len(self.ring(v)) for v in range(len(self.p))]
        aim = [4 if self.border(v) else 6 for v in range(len(self.p))]
        for a, b in self.edges():
            a, b = int(a), int(b)
            fs = sorted(self.vf[a] & self.vf[b])
            if len(fs) != 2:
                continue
            f, g = fs
            t = self.t[f]
            i = t.index(a)
            if t[(i + 1) % 3] != b:
                f, g = g, f
            c = next(x for x in self.t[f] if x != a and x != b)              # f = a b c, g = b a d
            d = next(x for x in self.t[g] if x != a and x != b)
            if self.vf[c] & self.vf[d] or val[a] <= 3 or val[b] <= 3 or (self.border(c) and self.border(d)):
                continue
            over = [val[v] - aim[v] for v in (a, b, c, d)]
            if sum((o + s) ** 2 for o, s in zip(over, (-1, -1, 1, 1))) >= sum(o * o for o in over):
                continue
            A, B, C, D = self.p[a], self.p[b], self.p[c], self.p[d]
            n0, n1 = self.normal(A, B, C), self.normal(B, A, D)
            m0, m1 = self.normal(C, D, B), self.normal(D, C, A)
            s = [x + y for x, y in zip(n0, n1)]
            l = sum(x * x for x in s)
            if any(sum(x * y for x, y in zip(s, m)) <= 0 or
                   sum(x * y for x, y in zip(s, m)) ** 2 < .4 * l * sum(x * x for x in m) for m in (m0, m1)):
                continue
            self.t[f], self.t[g] = (c, d, b), (d, c, a)
            self.vf[a].discard(f)
            self.vf[b].discard(g)
            self.vf[d].add(f)
            self.vf[c].add(g)
            for v, change in ((a, -1), (b, -1), (c, 1), (d, 1)):
                val[v] += change
            done += 1
        return done

    def pack(self):
        used = np.array([bool(s) for s in self.vf])
        new = np.cumsum(used) - 1
        verts = np.array(self.p)[used]
        tris = np.array([[new[v] for v in t] for t in self.t if t is not None])
        self.__init__(verts, tris)
        return verts, tris


def relax(verts, tris, body, strength=.6):
    """towards the mean of the neighbours, tangentially, then back onto the field; the border slides in its plane"""
    p = verts.copy()
    g = body.gradient(p)
    nrm = g / np.maximum(np.linalg.norm(g, axis=1, keepdims=True), 1e-9)
    e = np.vstack([tris[:, :2], tris[:, 1:], tris[:, [2, 0]]])
    e = np.unique(np.sort(e, axis=1), axis=0)
    mid = p[:, 0] == 0
    keep = mid[e[:, 0]] == mid[e[:, 1]]                            # border points see only border points
    s, n = np.zeros_like(p), np.zeros(len(p))
    for i, j in ((0, 1), (1, 0)):
        ok = keep | ~mid[e[:, i]]
        for c in range(3):
            s[:, c] += np.bincount(e[ok, i], p[e[ok, j], c], len(p))
        n += np.bincount(e[ok, i], minlength=len(p))
    d = s / np.maximum(n, 1)[:, None] - p
    d -= (d * nrm).sum(1, keepdims=True) * nrm
    p = p + strength * d
    p[mid, 0] = 0
    p[~mid, 0] = np.maximum(p[~mid, 0], 5e-4)
    p = body.towards(p, g)                                         # the gradient of before the move will do
    p[~mid, 0] = np.maximum(p[~mid, 0], 5e-4)
    return p


def edge_length(p):
    """wanted edge length at p: finer at fingers, toes and face"""
    ramp = lambda d, a, b: np.clip((d - a) / (b - a), 0, 1)
    hand = np.array(JOINT["LeftHand"])
    along = (p - hand) @ HAND_H
    out = p[:, 0] > .35
    L = np.full(len(p), .0172)
    L = np.where(out, np.minimum(L, .0172 - .0082 * ramp(along, -.03, .070) - .0022 * ramp(along, .07, .12)), L)
    face = np.linalg.norm((p - (0, 1.572, .100)) / (1, 1.25, 1.2), axis=1)
    L = np.minimum(L, .0076 + .0095 * ramp(face, .030, .110))
    mouth = np.linalg.norm((p - (0, 1.545, .105)) / (1.6, 1, 1.5), axis=1)
    L = np.minimum(L, .0058 + .0120 * ramp(mouth, .012, .075))
    ear = np.linalg.norm(p - (.078, 1.588, -.002), axis=1)
    L = np.minimum(L, .0088 + .0085 * ramp(ear, .03, .08))
    toe = np.linalg.norm((p - (.185, .01, .160)) / (1.2, 1.2, 1), axis=1)
    return np.minimum(L, .0086 + .0085 * ramp(toe, .035, .10))


def remesh(verts, tris, body, rounds=7, log=lambda *a: None):
    mesh = Mesh(verts, tris)
    for r in range(rounds):
        verts, tris = mesh.pack()
        want = edge_length(verts)
        n = mesh.split(want)
        want = edge_length(np.array(mesh.p))
        m = mesh.collapse(want)
        while r == 0 and m > 500:
            verts, tris = mesh.pack()
            m = mesh.collapse(edge_length(verts))
        k = mesh.flip()
        verts, tris = mesh.pack()
        for _ in range(2):
            verts = relax(verts, tris, body)
        mesh = Mesh(verts, tris)
        log(f"remesh {r + 1}/{rounds}: {len(verts)} vertices, {n} split, {m} collapsed, {k} flipped")
    for _ in range(2):
        verts = relax(verts, tris, body, .5)
    return body.project(verts, 3), tris


def mirror(verts, tris):
    mid = verts[:, 0] == 0
    twin = np.arange(len(verts))
    twin[~mid] = len(verts) + np.arange((~mid).sum())
    left = np.arange(len(verts))
    full = np.vstack([verts, verts[~mid] * MIRROR])
    other = np.concatenate([twin, left[~mid]])                     # partner of every vertex
    return full, np.vstack([tris, twin[tris][:, ::-1]]), other
