"""humanoid_field.py - the humanoid's joints, and its flesh as a field f(p): negative inside, about metres near f = 0

flow      joints + parts (muscles, bones, fat: swept tubes and ellipsoids) --smooth union--> f(p)
read      Sweep and Ellipsoid, then trunk_parts, leg_parts, arm_parts: every number of the body is there
"""
import numpy as np

# ------------------------------------------------------------------------------------------------ skeleton

TREE = """Hips - / Spine Hips / Spine1 Spine / Spine2 Spine1 / Neck Spine2 / Head Neck / HeadTop_End Head
/ @Shoulder Spine2 / @Arm @Shoulder / @ForeArm @Arm / @Hand @ForeArm
/ @HandThumb1 @Hand / @HandThumb2 @HandThumb1 / @HandThumb3 @HandThumb2 / @HandThumb4 @HandThumb3
/ @HandIndex1 @Hand / @HandIndex2 @HandIndex1 / @HandIndex3 @HandIndex2 / @HandIndex4 @HandIndex3
/ @HandMiddle1 @Hand / @HandMiddle2 @HandMiddle1 / @HandMiddle3 @HandMiddle2 / @HandMiddle4 @HandMiddle3
/ @HandRing1 @Hand / @HandRing2 @HandRing1 / @HandRing3 @HandRing2 / @HandRing4 @HandRing3
/ @HandPinky1 @Hand / @HandPinky2 @HandPinky1 / @HandPinky3 @HandPinky2 / @HandPinky4 @HandPinky3
/ @UpLeg Hips / @Leg @UpLeg / @Foot @Leg / @ToeBase @Foot / @Toe_End @ToeBase"""

JOINT = {                                # the left side and the middle, metres
    "Hips": (0, .960, .000), "Spine": (0, 1.048, .008), "Spine1": (0, 1.148, -.004), "Spine2": (0, 1.270, -.028),
    "Neck": (0, 1.462, -.006), "Head": (0, 1.522, .012), "HeadTop_End": (0, 1.725, .012),
    "LeftShoulder": (.062, 1.428, .002), "LeftArm": (.182, 1.372, -.002), "LeftForeArm": (.346, 1.182, -.006),
    "LeftHand": (.474, 1.056, .168),
    "LeftUpLeg": (.099, .908, -.006), "LeftLeg": (.136, .492, .012), "LeftFoot": (.166, .078, -.012),
    "LeftToeBase": (.180, .026, .122), "LeftToe_End": (.186, .014, .176),
}
MIRROR = np.array([-1.0, 1.0, 1.0])


def unit(v):
    v = np.asarray(v, float)
    return v / np.linalg.norm(v)


# The hand is laid out in its own axes, millimetres: h along the fingers, t towards the thumb, n out of the palm.
HAND_H = unit((.46, -.50, .73))
HAND_N = unit(np.array((-.74, -.67, 0)) - np.dot((-.74, -.67, 0), HAND_H) * HAND_H)
HAND_T = np.cross(HAND_N, HAND_H)


def hand_point(h, t, n):
    return np.array(JOINT["LeftHand"]) + (h * HAND_H + t * HAND_T + n * HAND_N) * 1e-3


# finger: knuckle (h,t,n), spread (degrees towards the thumb), bend of each bone (degrees towards the palm), lengths
FINGERS = {
    "Index": ((90, 34, -3), 10, (12, 30, 42), (43, 26, 22), 9.2),
    "Middle": ((95, 10, -5), 3, (13, 32, 45), (47, 30, 23), 9.4),
    "Ring": ((90, -14, -4), -6, (14, 33, 46), (43, 28, 23), 9.0),
    "Pinky": ((80, -37, 0), -17, (15, 32, 43), (34, 21, 20), 8.1),
}
THUMB = ((20, 27, 10), (57, 55, 27), (86, 72, 35), (110, 83, 39))


def place_fingers():
    for i, p in enumerate(THUMB):
        JOINT[f"LeftHandThumb{i + 1}"] = hand_point(*p)
    for name, (knuckle, spread, bend, length, _) in FINGERS.items():
        p, s = np.array(knuckle, float), np.radians(spread)
        JOINT[f"LeftHand{name}1"] = hand_point(*p)
        for i in range(3):
            b = np.radians(bend[i])
            p = p + length[i] * np.array((np.cos(b) * np.cos(s), np.cos(b) * np.sin(s), np.sin(b)))
            JOINT[f"LeftHand{name}{i + 2}"] = hand_point(*p)


def skeleton():
    """names (S), parents (S), rest positions (S,3); arms left then right, legs left then right"""
    rows = [r.split() for r in TREE.split("/")]
    arm = [r for r in rows if "Shoulder" in r[0] or "Arm" in r[0] or "Hand" in r[0]]
    mid = [r for r in rows if "@" not in r[0]]
    leg = [r for r in rows if "@" in r[0] and r not in arm]
    side = lambda part, s: [[w.replace("@", s) for w in r] for r in part]
    rows = mid + side(arm, "Left") + side(arm, "Right") + side(leg, "Left") + side(leg, "Right")
    names = [r[0] for r in rows]
    parents = np.array([names.index(r[1]) if r[1] in names else -1 for r in rows])
    rest = np.array([JOINT[n.replace("Right", "Left")] * (MIRROR if n[:5] == "Right" else 1) for n in names])
    return names, parents, rest


# ------------------------------------------------------------------------------------------------ parts of the field
# Each part: f(p) about the signed distance near its surface, from k0 = |p/r|, k1 = |p/r^2|: f = k0 (k0 - 1) / k1.
REACH = .06                              # beyond its box grown by this a part is not evaluated and has no effect
FAR = 1.0


def smin(a, b, k):
    """smooth union: min(a,b) - k/4 * h^2, h = max(1 - |a-b|/k, 0)"""
    h = np.maximum(1 - np.abs(a - b) / k, 0) * (np.abs(a) < FAR)    # two absent parts do not grow towards each other
    return np.minimum(a, b) - k / 4 * h * h


def smax(a, b, k):
    return -smin(-a, -b, k)


class Ellipsoid:
    """centre, three radii, and optionally the directions of the first two axes"""

    def __init__(self, centre, radii, x=(1, 0, 0), y=(0, 1, 0)):
        self.c, self.r = np.array(centre, float), np.array(radii, float)
        x = unit(x)
        y = unit(np.array(y) - np.dot(y, x) * x)
        self.axes = np.stack([x, y, np.cross(x, y)])
        ext = np.sqrt(((self.axes * self.r[:, None]) ** 2).sum(0))
        self.lo, self.hi = self.c - ext, self.c + ext

    def f(self, p):
        q = (p - self.c) @ self.axes.T / self.r
        k0 = np.sqrt((q * q).sum(1))
        k1 = np.sqrt(((q / self.r) ** 2).sum(1))
        return np.where(k1 > 1e-6, k0 * (k0 - 1) / np.maximum(k1, 1e-6), -self.r.min())


class Sweep:
    """a tube along a Catmull-Rom curve; each station is (x, y, z, out, in, front, back): a centre and four radii,
    quarter ellipses joined smoothly. `front` names the direction the front radius points, `out` is to its side"""

    def __init__(self, stations, front=(0, 0, 1), n=2.0, cap=(1, 1), steps=6):
        s = np.array([tuple(a) if len(a) == 7 else tuple(a[:3]) + (a[3],) * 4 for a in stations], float)
        e = np.vstack([2 * s[0] - s[1], s, 2 * s[-1] - s[-2]])
        e[0, 3:], e[-1, 3:] = s[0, 3:], s[-1, 3:]
        t = (np.arange(steps) / steps)[:, None]
        rows = []
        for i in range(len(s) - 1):
            a, b, c, d = e[i:i + 4]
            rows.append(b + t / 2 * ((c - a) + t * ((2 * a - 5 * b + 4 * c - d) + t * (3 * b - a - 3 * c + d))))
        self.s = np.vstack(rows + [s[-1:]])
        self.c, self.r = self.s[:, :3], np.maximum(self.s[:, 3:], 1e-3)
        u = np.gradient(self.c, axis=0)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        fr = np.array(front, float) - (u @ np.array(front, float))[:, None] * u
        self.u, self.front = u, fr / np.linalg.norm(fr, axis=1, keepdims=True)
        self.out = np.cross(self.u, self.front)
        self.out *= np.where(self.out[:, :1] < 0, -1, 1) if abs(self.out[:, 0]).min() > .2 else 1
        self.n, self.cap = n, cap
        m = self.r.max()
        self.lo, self.hi = self.c.min(0) - m, self.c.max(0) + m

    def f(self, p):
        a, d = self.c[:-1], self.c[1:] - self.c[:-1]
        j = (p @ (-2 * self.c.T) + (self.c * self.c).sum(1)).argmin(1)     # nearest station, then its two segments
        best, at = np.full(len(p), np.inf), np.zeros(len(p))
        for i in (np.maximum(j - 1, 0), np.minimum(j, len(a) - 1)):
            v, s = p - a[i], d[i]
            t = np.clip((v * s).sum(1) / (s * s).sum(1), 0, 1)
            v = v - t[:, None] * s
            q = (v * v).sum(1)
            at = np.where(q < best, i + t, at)
            best = np.minimum(q, best)
        i = np.minimum(at.astype(int), len(a) - 1)
        w = (at - i)[:, None]
        mix = lambda x: x[i] * (1 - w) + x[i + 1] * w
        r, v = mix(self.r), p - mix(self.c)
        x, z, e = (v * mix(self.out)).sum(1), (v * mix(self.front)).sum(1), (v * mix(self.u)).sum(1)
        rx, rz = np.where(x > 0, r[:, 0], r[:, 1]), np.where(z > 0, r[:, 2], r[:, 3])
        re = np.where(at < len(a) / 2, self.cap[0], self.cap[1]) * (rx + rz) / 2
        qx, qz, qe = np.abs(x / rx), np.abs(z / rz), np.abs(e / re)
        n = self.n
        k0 = (qx ** n + qz ** n) ** (1 / n) if n != 2 else np.sqrt(qx * qx + qz * qz)
        k0 = np.sqrt(k0 * k0 + qe * qe)
        k1 = np.sqrt((qx / rx) ** 2 + (qz / rz) ** 2 + (qe / re) ** 2)
        return np.where(k1 > 1e-6, k0 * (k0 - 1) / np.maximum(k1, 1e-6), -np.minimum(rx, rz))


class Part:
    """a shape with its way of joining what is there already: union, or cut (smooth subtraction)"""

    def __init__(self, shape, k, pair=False, cut=False, pair_k=None):
        self.shape, self.k, self.pair, self.cut = shape, k, pair, cut
        self.pair_k = k if pair_k is None else pair_k

    def value(self, p):
        """the shape's field near it, FAR elsewhere"""
        s, v = self.shape, np.full(len(p), FAR)
        m = ((p > s.lo - REACH) & (p < s.hi + REACH)).all(1)
        if m.any():
            v[m] = s.f(p[m])
        return v

    def join(self, f, p):
        v = self.value(p)
        if self.pair:
            v = smin(v, self.value(p * MIRROR), self.pair_k)
        return smax(f, -v, self.k) if self.cut else smin(f, v, self.k)


def group(parts, p):
    f = np.full(len(p), FAR)
    for part in parts:
        f = part.join(f, p)
    return f


# ------------------------------------------------------------------------------------------------ the body

def trunk_parts():
    S, E = Sweep, Ellipsoid
    torso = [  # y, half width, front z, back z
        (.845, .090, .060, -.070), (.880, .128, .086, -.080), (.920, .152, .097, -.080), (.965, .158, .100, -.074),
        (1.010, .153, .101, -.062), (1.060, .144, .099, -.053), (1.110, .139, .098, -.052), (1.160, .141, .100, -.060),
        (1.210, .148, .105, -.073), (1.260, .154, .108, -.085), (1.310, .156, .105, -.093), (1.355, .150, .093, -.094),
        (1.395, .133, .072, -.087), (1.430, .100, .050, -.076), (1.460, .066, .036, -.064)]
    rows = [(0, y, (a + b) / 2, w, w, (a - b) / 2, (a - b) / 2) for y, w, a, b in torso]
    return [
        Part(S(rows, n=2.35, cap=(.5, .5)), .02),
        # neck: column, the two sternomastoids, trapezius sloping to the shoulder tip
        Part(S([(0, 1.415, -.022, .062), (0, 1.470, -.014, .056, .056, .054, .056),
                (0, 1.520, .000, .053, .053, .053, .054), (0, 1.575, .010, .054)]), .04),
        Part(S([(.014, 1.436, .036, .011), (.034, 1.490, .028, .013), (.055, 1.552, .002, .013)]), .018, True),
        Part(S([(.022, 1.520, -.034, .026), (.056, 1.462, -.034, .032), (.105, 1.425, -.026, .034),
                (.160, 1.398, -.012, .032)]), .035, True),
        Part(S([(.020, 1.434, .040, .010), (.075, 1.440, .036, .0095), (.125, 1.424, .014, .010),
                (.168, 1.412, .004, .011)]), .022, True),                                            # collarbone
        # chest and back
        Part(E((.076, 1.318, .060), (.084, .060, .052), x=(.95, .30, -.12), y=(-.3, 1, .22)), .03, True, pair_k=.014),
        Part(E((.132, 1.350, .030), (.066, .044, .042), x=(.85, .36, -.30)), .04, True),         # pectoral to the arm
        Part(E((.106, 1.240, -.034), (.046, .150, .048), x=(1, 0, .3), y=(.18, 1, -.05)), .045, True),   # latissimus
        Part(E((.088, 1.345, -.064), (.062, .085, .032), x=(1, .1, .25)), .04, True),            # shoulder blade
        Part(S([(.028, .985, -.054, .022), (.033, 1.100, -.036, .024), (.036, 1.220, -.056, .026),
                (.030, 1.330, -.070, .022)]), .04, True, pair_k=.012),                               # erector spinae
        Part(E((.062, 1.205, .066), (.072, .066, .034), x=(1, -.2, -.3)), .045, True),            # lower ribs
        Part(S([(.036, 1.200, .080, .022), (.038, 1.110, .081, .023), (.036, 1.020, .081, .023),
                (.026, .930, .076, .020)]), .035, True, pair_k=.016),                                # rectus abdominis
        Part(E((.112, 1.040, .024), (.036, .075, .058), x=(1, 0, -.15)), .05, True),             # flank
        # pelvis: hip bone edge, buttocks, pubic region
        Part(E((.096, .985, .050), (.052, .044, .036), x=(.8, .5, -.5)), .045, True),
        Part(E((.075, .898, -.050), (.076, .088, .074), x=(1, 0, .1), y=(.12, 1, .16)), .04, True, pair_k=.008),
        Part(E((.124, .925, -.012), (.046, .110, .066)), .055, True),                            # gluteus medius, hip
        Part(E((0, .872, .050), (.050, .055, .042)), .03),
    ] + head_parts() + [
        Part(E((0, 1.046, .112), (.006, .009, .012)), .012, cut=True),                           # navel
        Part(S([(0, 1.400, .098, .010), (0, 1.330, .118, .010), (0, 1.250, .118, .009)]), .022,
             cut=True),                                                                          # breastbone
    ]


def head_parts():
    S, E = Sweep, Ellipsoid
    return [
        Part(E((0, 1.632, .000), (.075, .093, .092), y=(0, 1, -.15)), .03),                      # cranium
        Part(E((0, 1.640, .030), (.068, .078, .074)), .03),                                      # forehead
        Part(E((0, 1.572, .046), (.058, .082, .056)), .03),                                      # face
        Part(S([(.050, 1.570, .016, .018), (.045, 1.536, .034, .017), (.026, 1.514, .070, .016),
                (0, 1.507, .086, .017)]), .02, True),                                                # jaw
        Part(E((0, 1.510, .094), (.017, .013, .013)), .014),                                     # chin
        Part(E((0, 1.543, .080), (.036, .034, .027)), .02),                                      # mouth region
        Part(E((.040, 1.552, .050), (.024, .034, .030)), .025, True),                            # cheek
        Part(E((.045, 1.581, .064), (.022, .015, .024), x=(1, .2, -.6)), .022, True),            # cheek bone
        Part(S([(.006, 1.622, .098, .010), (.030, 1.627, .091, .009), (.052, 1.620, .070, .009)]), .016, True),   # brow
        Part(E((.032, 1.603, .108), (.019, .012, .018)), .012, True, cut=True),                  # eye socket
        Part(E((.0315, 1.602, .0835), (.0145, .0125, .0135)), .005, True),                       # eye, lids closed
        Part(S([(0, 1.618, .098, .007), (0, 1.594, .108, .0075), (0, 1.571, .119, .0098)]), .014),   # nose
        Part(E((.0095, 1.565, .112), (.0085, .008, .011)), .008, True),                          # nostril wing
        Part(S([(-.025, 1.5405, .0960, .0045), (-.013, 1.5450, .1045, .0060), (0, 1.5450, .1070, .0065),
                (.013, 1.5450, .1045, .0060), (.025, 1.5405, .0960, .0045)]), .005),             # lips
        Part(S([(-.023, 1.5375, .0955, .0045), (-.012, 1.5315, .1030, .0065), (0, 1.5305, .1050, .0075),
                (.012, 1.5315, .1030, .0065), (.023, 1.5375, .0955, .0045)]), .0025),
        Part(E((.0765, 1.588, -.004), (.0085, .032, .019), x=(1, 0, .45), y=(0, 1, -.25)), .004, True),      # ear
        Part(E((.0845, 1.590, .002), (.005, .017, .009), x=(1, 0, .45), y=(0, 1, -.25)), .006, True, cut=True),
    ]


def leg_parts():
    S, E, J = Sweep, Ellipsoid, {k: np.array(v, float) for k, v in JOINT.items()}
    hip, knee, foot = J["LeftUpLeg"], J["LeftLeg"], J["LeftFoot"]
    at = lambda a, b, t, dx=0, dz=0: a + (b - a) * t + np.array((dx, 0, dz))
    row = lambda c, *r: tuple(c) + r
    thigh = [row(at(hip, knee, -.06, .004), .078, .072, .078, .070), row(at(hip, knee, .10), .080, .080, .086, .074),
             row(at(hip, knee, .28), .075, .080, .090, .070), row(at(hip, knee, .48), .067, .070, .084, .064),
             row(at(hip, knee, .68), .059, .058, .072, .056), row(at(hip, knee, .86), .052, .052, .056, .052),
             row(at(hip, knee, 1.0), .049, .051, .050, .050), row(at(knee, foot, .12), .047, .048, .043, .054),
             row(at(knee, foot, .28), .050, .047, .040, .062), row(at(knee, foot, .44), .047, .043, .038, .060),
             row(at(knee, foot, .60), .041, .037, .037, .053), row(at(knee, foot, .76), .034, .032, .034, .044),
             row(at(knee, foot, .90), .030, .029, .035, .039), row(at(knee, foot, 1.0), .031, .030, .038, .038)]
    x, z = foot[0], foot[2]
    toes = [((-.020, .124), (-.021, .182), .0130, .0140), ((.0025, .130), (.0065, .186), .0096, .0098),
            ((.0195, .126), (.0260, .177), .0092, .0094), ((.0350, .118), (.0435, .164), .0088, .0090),
            ((.0490, .106), (.0590, .148), .0084, .0088)]
    return [
        Part(S(thigh), .02),
        Part(E(at(hip, knee, .78, -.022, .040), (.026, .056, .024), y=(-.1, 1, 0)), .025),       # vastus medialis
        Part(E(at(hip, knee, .62, .034, .026), (.030, .100, .040), y=(-.1, 1, 0)), .03),         # vastus lateralis
        Part(E(knee + (.002, .014, .040), (.025, .036, .014)), .022),                            # kneecap
        Part(S([tuple(knee + (.002, -.03, .036)) + (.013,), tuple(knee + (.004, -.075, .034)) + (.012,),
                tuple(at(knee, foot, .6, -.004, .018)) + (.012,)]), .02),                        # shin
        Part(E(at(knee, foot, .26, -.024, -.040), (.028, .112, .028), y=(.05, 1, .07)), .05),    # calf, inner head
        Part(E(at(knee, foot, .24, .022, -.038), (.026, .104, .026), y=(.05, 1, .07)), .05),     # calf, outer head
        Part(S([tuple(at(knee, foot, .60, .0, -.034)) + (.017,), tuple(at(knee, foot, .82, .0, -.036)) + (.011,),
                (x, .060, z - .040, .017), (x, .036, z - .032, .026)]), .03),                        # Achilles tendon
        # foot: heel, arch, ball, toes, ankle bones
        Part(E((x - .001, .032, z - .030), (.030, .038, .038)), .03),
        Part(S([(x, .066, z - .012, .030, .029, .028, .040), (x + .001, .058, z + .028, .031, .030, .020, .045),
                (x + .004, .044, z + .068, .036, .034, .014, .034), (x + .009, .031, z + .104, .044, .039, .010, .026),
                (x + .013, .022, z + .128, .047, .041, .007, .018)], front=(0, 1, .3), n=2.3, cap=(1, .35)), .02),
        Part(E((x + .028, .068, z + .002), (.009, .015, .013)), .018),
        Part(E((x - .026, .078, z + .008), (.010, .016, .014)), .018),
        Part(E((x - .024, .026, z + .116), (.018, .022, .026)), .015),
        Part(E((x + .044, .020, z + .074), (.013, .018, .040), x=(1, 0, -.15)), .016),
    ] + [Part(S([(x + a[0], .019 - i * .001, z + a[1], r),
                 (x + (a[0] + b[0]) / 2, .019 - i * .0015, z + (a[1] + b[1]) / 2, r),
                 (x + b[0], r + .0005, z + b[1], r1)], cap=(.8, .8)), .006)
         for i, (a, b, r, r1) in enumerate(toes)]


def arm_parts():
    S, E, J = Sweep, Ellipsoid, {k: np.array(v, float) for k, v in JOINT.items()}
    sh, el, wr = J["LeftArm"], J["LeftForeArm"], J["LeftHand"]
    u, v = unit(el - sh), unit(wr - el)
    fwd, out = np.array((0, 0, 1.0)), unit(np.cross((0, 0, 1.0), u)) * -1
    if out[0] < 0:
        out = -out
    at = lambda a, b, t, o=0.0, z=0.0: a + (b - a) * t + o * out + z * fwd
    row = lambda c, *r: tuple(c) + r
    bend = unit(v - u)                                             # inside of the elbow
    arm = [row(at(sh, el, -.05, -.004), .044, .046, .050, .048), row(at(sh, el, .15), .045, .046, .052, .050),
           row(at(sh, el, .35), .041, .042, .048, .048), row(at(sh, el, .55), .038, .039, .046, .045),
           row(at(sh, el, .75), .036, .037, .041, .041), row(at(sh, el, .90), .037, .037, .037, .040)]
    arm += [row(el + bend * .004, .038, .037, .036, .038)]
    fore = [row(el + bend * .004, .036, .036, .035, .036),
            row(at(el, wr, .14), .040, .038, .036, .036), row(at(el, wr, .28), .040, .038, .036, .035),
            row(at(el, wr, .45), .036, .034, .033, .032), row(at(el, wr, .62), .031, .029, .029, .027),
            row(at(el, wr, .80), .026, .025, .024, .022), row(at(el, wr, .94), .0255, .0245, .0205, .019),
            row(wr + v * .006, .0265, .0255, .0195, .0185)]
    side = unit(HAND_T - np.dot(HAND_T, v) * v)                    # the forearm's wide side turns into the hand's
    H = hand_point
    palm = [row(H(-12, 0, 0), .026, .026, .019, .0185), row(H(14, 2, 0), .029, .030, .0185, .017),
            row(H(42, 2, 0), .037, .037, .0165, .0155), row(H(64, 0, -1), .0425, .042, .0145, .0135),
            row(H(78, -1, -2), .0435, .0425, .0115, .0115)]
    parts = [
        Part(S(arm), .02),
        Part(S(fore, front=HAND_N), .02),
        Part(E(at(sh, el, .10, .012, .000), (.098, .046, .060), x=u, y=out), .03),               # deltoid
        Part(E(at(sh, el, -.02, .006, .026), (.060, .036, .034), x=u, y=out), .025),
        Part(E(at(sh, el, .52, .000, .022), (.085, .031, .028), x=u, y=out), .02),               # biceps
        Part(E(at(sh, el, .42, -.004, -.024), (.092, .034, .030), x=u, y=out), .02),             # triceps
        Part(E(at(sh, el, .12, -.030, -.020), (.080, .030, .036), x=u, y=out), .03),             # rear of the armpit
        Part(E(at(sh, el, .10, -.026, .020), (.075, .026, .030), x=u, y=out), .03),
        Part(E(el - bend * .026 + u * .004, (.026, .016, .018), x=u, y=bend), .022),             # elbow bone
        Part(E(at(el, wr, .17) + side * .018 + bend * .006, (.075, .025, .026), x=v, y=side), .02),
        Part(E(at(el, wr, .22) - side * .014 - bend * .004, (.078, .026, .027), x=v, y=side), .02),
        Part(E(at(el, wr, .95) - side * .016 - HAND_N * .009, (.014, .011, .010), x=v, y=side), .012),   # ulna's head
        Part(S(palm, front=HAND_N, n=2.5, cap=(.6, .45)), .015),
        Part(E(H(38, 32, 13), (.036, .017, .015), x=H(57, 55, 27) - H(20, 27, 10), y=HAND_N), .012),  # thumb's ball
        Part(E(H(50, 38, 9), (.026, .018, .010), x=HAND_H, y=HAND_T), .014),                     # web of the thumb
        Part(E(H(40, -27, 8), (.034, .015, .014), x=HAND_H, y=HAND_T), .012),
    ]
    knuckles = [np.array(spec[0], float) for spec in FINGERS.values()]
    for k in knuckles:
        parts.append(Part(E(H(k[0] - 2, k[1], k[2] - 4), (.012, .0095, .0085), x=HAND_H, y=HAND_T), .008))
    for a, b in zip(knuckles, knuckles[1:]):                       # webs, then the fingers
        k = (a + b) / 2
        parts.append(Part(E(H(k[0] - 3, k[1], k[2] + 1), (.015, .011, .008), x=HAND_H, y=HAND_T), .006))
    for name, spec in FINGERS.items():
        p, r = [J[f"LeftHand{name}{i}"] for i in (1, 2, 3, 4)], spec[4] * 1e-3
        nail = unit(p[3] - p[2])
        rows = [row(p[0] - HAND_H * .010, r), row(p[0], r * 1.0), row((p[0] + p[1]) / 2, r * .97), row(p[1], r * .97),
                row((p[1] + p[2]) / 2, r * .88), row(p[2], r * .87), row((p[2] + p[3]) / 2, r * .80),
                row(p[3] - nail * r * .55, r * .68)]
        parts.append(Part(S(rows, steps=3), .003))
    t = [J[f"LeftHandThumb{i}"] for i in (1, 2, 3, 4)]
    tip = unit(t[3] - t[2])
    rows = [row(t[0], .0125), row((t[0] + t[1]) / 2, .0120), row(t[1], .0106), row((t[1] + t[2]) / 2, .0094),
            row(t[2], .0097), row((t[2] + t[3]) / 2, .0090), row(t[3] - tip * .006, .0070)]
    parts.append(Part(S(rows, steps=3), .008))
    return parts


class Body:
    def __init__(self):
        self.trunk, self.leg, self.arm = trunk_parts(), leg_parts(), arm_parts()

    def groups(self, p):
        """fields of trunk with head, left leg, left arm with hand"""
        return group(self.trunk, p), group(self.leg, p), group(self.arm, p)

    def f(self, p):
        trunk, left, arm = self.groups(p)
        right = np.full(len(p), FAR)
        m = p[:, 0] < .12
        right[m] = group(self.leg, p[m] * MIRROR)
        f = smin(trunk, smin(left, right, .010), .045)
        return smax(smin(f, arm, .042), -p[:, 1], .006)            # flat soles

    def gradient(self, p, h=5e-4):
        """central differences by four points of a tetrahedron"""
        g = np.zeros_like(p)
        for s in np.array([(1, -1, -1), (-1, -1, 1), (-1, 1, -1), (1, 1, 1)], float):
            g += s * self.f(p + h * s)[:, None]
        return g / (4 * h)

    def towards(self, p, g):
        """one Newton step onto f = 0, at most 4 mm; points of the mirror plane stay in it"""
        g = g * np.where(p[:, :1] == 0, (0, 1, 1), 1)
        d = np.clip(self.f(p) / np.maximum((g * g).sum(1), .05), -.004, .004)
        return p - d[:, None] * g

    def project(self, p, steps):
        for _ in range(steps):
            p = self.towards(p, self.gradient(p))
        return p
