"""Every field straight from its definition: plain NumPy over all grains, contacts and images, no neighbour search.

Nothing here is shared with the package: profiles are written out, marginals and segment integrals are quadratures.
"""

import itertools
import math

import numpy as np

X, W = np.polynomial.legendre.leggauss(64)


def _lucy(q, spread):
    return (1 - q) ** 3 * (1 + 3 * q)


def _gaussian(q, spread):
    return np.exp(-(q**2) / (2 * spread**2))


def _shifted_gaussian(q, spread):
    return _gaussian(q, spread) - _gaussian(1, spread)


def _heaviside(q, spread):
    return np.ones_like(q)


# cutoff over width, and the profile of q = r / c, of the kernels of the package
KERNELS = {
    "lucy": (2.0, _lucy),
    "gaussian": (3.0, _gaussian),
    "shifted gaussian": (3.0, _shifted_gaussian),
    "heaviside": (1.0, _heaviside),
}


def _profile(name, q, spread):
    _, profile = KERNELS[name]
    return np.where(q < 1, profile(q, spread), 0.0)


def _gauss(f, a, b):
    """Integral of f (vectorised, last axis the points) from a to b (arrays of equal shape)."""
    mid = (np.asarray(a) + b) / 2
    half = (np.asarray(b) - a) / 2
    return half * (f(mid[..., None] + half[..., None] * X) * W).sum(axis=-1)


class BruteKernel:
    """A kernel in k dimensions seen in m of them, by quadrature."""

    def __init__(self, name, width, dimension=3, seen=3):
        self.name, self.seen, self.n = name, seen, dimension - seen
        ratio, _ = KERNELS[name]
        self.c, self.spread = ratio * width, 1 / ratio
        sphere = {1: 2.0, 2: 2 * math.pi, 3: 4 * math.pi}[dimension]
        total = _gauss(
            lambda q: _profile(name, q, self.spread) * q ** (dimension - 1),
            np.zeros(()),
            np.ones(()),
        )
        self.norm = 1 / (sphere * total * self.c**dimension)

    def __call__(self, rho):
        q = np.asarray(rho, float) / self.c
        if self.n == 0:
            return self.norm * _profile(self.name, q, self.spread)
        safe = np.clip(q, 1e-14, 1.0)
        if self.n == 1:  # z = q sinh u keeps the integrand smooth near q = 0
            u = np.arcsinh(np.sqrt(1 - safe**2) / safe)
            line = _gauss(
                lambda u: _profile(self.name, np.minimum(safe[..., None] * np.cosh(u), 1 - 1e-16), self.spread)
                * safe[..., None] * np.cosh(u),
                np.zeros_like(u), u,
            )  # fmt: skip
            return np.where(q < 1, 2 * line, 0.0) * self.norm * self.c
        disc = _gauss(
            lambda r: _profile(self.name, np.minimum(r, 1 - 1e-16), self.spread) * r,
            safe,
            np.ones_like(safe),
        )
        return np.where(q < 1, 2 * np.pi * disc, 0.0) * self.norm * self.c**2

    def segment(self, r, start, end):
        """Mean over the segment, split where it enters and leaves the support and where it passes the point."""
        b = end - start
        length2 = b @ b
        if length2 == 0:
            return float(self(np.linalg.norm(r - start)))
        d = r - start
        foot = d @ b / length2
        h2 = max(0.0, d @ d - foot**2 * length2)
        if h2 >= self.c**2:
            return 0.0
        half = math.sqrt((self.c**2 - h2) / length2)
        cuts = np.unique(np.clip([0, 1, foot - half, foot, foot + half], 0, 1))
        total = 0.0
        for lo, hi in itertools.pairwise(cuts):
            if (lo + hi) / 2 > foot + half or (lo + hi) / 2 < foot - half:
                continue

            # u = centre + half sin(a) takes the root at the rim out of marginals
            def angle(u):
                return math.asin(min(1.0, max(-1.0, (u - foot) / half)))

            def f(a):
                u = foot + half * np.sin(a)
                rho = np.sqrt(h2 + length2 * (u - foot) ** 2)
                return self(np.minimum(rho, self.c * (1 - 1e-16))) * half * np.cos(a)

            total += float(_gauss(f, np.asarray(angle(lo)), np.asarray(angle(hi))))
        return total


def brute_force(ds, kernel, points, seen="xyz", scale=1.0, gradient=True):
    """All fields at points (k, 3) of the first step; axes not in `seen` are integrated over, times `scale`."""
    frame = {n: ds[n].isel(time=0).values for n in ds.data_vars}
    keep = frame["particle_id"] >= 0
    axes = ["xyz".index(a) for a in seen]
    period = [
        (frame["box"][k, 1] - frame["box"][k, 0]) if "xyz"[k] in ds.attrs["periodic"] else 0.0
        for k in range(3)
    ]
    plane = ["xyz".index(a) for a in ds.attrs["plane"]]
    pos = frame["position"][keep]
    vel = frame["velocity"][keep]
    mass = frame["mass"][keep]
    vol = frame["volume"][keep]
    dia = frame["diameter"][keep]
    ids = {int(n): k for k, n in enumerate(frame["particle_id"][keep])}
    far = [math.ceil(2 * kernel.c / p) + 1 if p else 0 for p in period]
    reach = [range(-n, n + 1) if k in axes else (0,) for k, n in enumerate(far)]
    shifts = [np.array(n) * period for n in itertools.product(*reach)]

    def nearest(vector):
        return np.array(
            [v - p * round(v / p) if p else v for v, p in zip(vector, period, strict=True)]
        )

    contacts = []
    if "contact_i" in frame:
        for i, j, f, c in zip(
            *(frame[f"contact_{n}"] for n in ("i", "j", "force", "point")), strict=True
        ):
            if i >= 0:
                contacts.append((ids[int(i)], ids.get(int(j), -1), f, c))
    partners = [set() for _ in mass]
    normals = np.zeros((len(mass), 3, 3))
    total = np.zeros((len(mass), 3))
    sides = []
    wall = []
    for row, (i, j, f, c) in enumerate(contacts):
        a = nearest(pos[i] - (pos[j] if j >= 0 else c))
        n = a / np.linalg.norm(a) if np.linalg.norm(a) > 0 else np.zeros(3)
        for k, sign, other in ((i, 1, j), (j, -1, i)):
            if k >= 0:
                partners[k].add(other if other >= 0 else ("wall", row))
                normals[k] += np.outer(n, n)
                total[k] += sign * f
                sides.append((k, sign * f, nearest(pos[k] - c)))
        if j < 0:
            wall.append((f, c))
    z = np.array([len(s) for s in partners], float)

    out = {}

    def put(name, value):
        out.setdefault(name, []).append(value)

    for r in points:
        w = []
        x = []
        owner = []
        for shift in shifts:
            dx = np.zeros_like(pos)
            dx[:, axes] = (pos + shift - r)[:, axes]
            q = np.linalg.norm(dx, axis=1)
            hit = np.flatnonzero(q < kernel.c)
            if len(hit):
                w.append(kernel(q[hit]))
                x.append(dx[hit])
                owner.append(hit)
        k = np.concatenate(owner) if owner else np.zeros(0, int)
        w = (np.concatenate(w) if w else np.zeros(0)) * scale
        x = np.concatenate(x) if x else np.zeros((0, 3))
        m = mass[k] * w
        v = vel[k]
        rho = m.sum()
        count = len(k)
        nan = np.full(3, np.nan)
        put("sample_count", count)
        put("volume_fraction", vol[k] @ w)
        put("density", rho)
        put("number_density", w.sum())
        put("particle_density", rho / (vol[k] @ w) if count else np.nan)
        put("momentum_density", m @ v)
        V = m @ v / rho if count else nan
        put("velocity", V)
        put("d32", dia[k] ** 3 @ w / (dia[k] ** 2 @ w) if count else np.nan)
        put("d43", dia[k] ** 4 @ w / (dia[k] ** 3 @ w) if count else np.nan)
        put("coordination_number", z[k] @ w / w.sum() if count else np.nan)
        put("fabric", np.einsum("n,nij->ij", vol[k] * w, normals[k]))
        put("contact_force_density", w @ total[k])
        sk = np.einsum("n,ni,nj->ij", m, v - V, v - V) if count else np.zeros((3, 3))
        put("kinetic_stress", sk)
        sc = np.zeros((3, 3))
        t = np.zeros(3)
        for shift in shifts:
            for i, f, a in sides:
                start = pos[i] + shift
                end = pos[i] - a + shift
                here = r
                if (np.abs(start - here)[axes] > kernel.c + np.abs(a)[axes]).any():
                    continue
                s = kernel.segment(here[axes], start[axes], end[axes])
                sc += scale * s * np.outer(f, a)
            for f, c in wall:
                q = np.linalg.norm((c + shift - r)[axes])
                if q < kernel.c:
                    t += scale * kernel(np.asarray(q)) * f
        put("contact_stress", sc)
        put("boundary_force_density", t)
        stress = sc + sk
        put("stress", stress)
        D = len(plane)
        p = sum(stress[i, i] for i in plane) / D
        put("pressure", p)
        dev = stress.copy()
        for i in plane:
            dev[i, i] -= p
        put("deviatoric_stress", dev)
        put("shear_stress", np.sqrt((dev**2).sum() / 2))
        mu = np.sqrt((dev**2).sum() / 2) / p if p > 0 else np.nan
        put("friction_coefficient", mu)
        put("effective_count", rho**2 / (np.bincount(k, m) ** 2).sum() if count else np.nan)
        # weighted least squares by LAPACK, not by normal equations
        G = np.full((3, 3), np.nan)
        T = np.nan
        rank = 0
        free = 0.0
        if count:
            centre = m @ x / rho
            root = np.sqrt(m)[:, None]
            design = root * (x - centre)[:, axes]
            rhs = root * (v - V)
            fit, _, rank, size = np.linalg.lstsq(design, rhs, rcond=1e-5)
            G = np.zeros((3, 3))
            G[:, axes] = fit.T
            rest = v - V - (x - centre) @ G.T
            fluctuation = np.einsum("n,ni,nj->ij", m, rest, rest)
            # what independent velocities of the grains leave: the fit to the velocity of one grain after the other
            one = np.eye(len(mass))[k]
            mean = m @ one / rho
            left = (
                one
                - mean
                - (x - centre)[:, axes]
                @ np.linalg.lstsq(design, root * (one - mean), rcond=1e-5)[0]
            )
            free = m @ (left**2).sum(axis=1)
            if count > rank + 1 and free > 0.5 * rho / count:
                T = sum(fluctuation[i, i] for i in plane) / (D * free)
            if ((size > 1e-6 * size[:1]) & (size < 1e-3 * size[:1])).any():
                T = None  # whether such a direction counts is a matter of taste
            if rank < len(axes) or size[-1] < 0.1 * size[0]:
                G = None  # nearly flat clouds leave few digits, flat ones no derivative across
        put("velocity_gradient", G)
        put("granular_temperature", T)
        put("fluctuation_density", free)
        if G is None:
            put("shear_rate", None)
            put("inertial_number", None)
        else:
            gamma = (G + G.T) / 2
            trace = sum(gamma[i, i] for i in plane)
            for i in plane:
                gamma[i, i] -= trace / D
            rate = np.sqrt(2 * (gamma**2).sum())
            put("shear_rate", rate)
            d = out["d43"][-1]
            put(
                "inertial_number",
                rate * d * np.sqrt(out["particle_density"][-1] / p) if p > 0 else np.nan,
            )
    return out


def weights(ds, kernel, f, places, extent):
    """Weights (nodes, places) of points at the nodes of a result, all images added, over the extent of averaged axes.

    `places` (n, 3) are contact points or centres, `kernel` the one seen in the axes of the result, None for none;
    `extent` holds the lengths of averaged axes that the box does not have.
    """
    seen = [k for k, a in enumerate("xyz") if a in f.coords]
    lists = np.meshgrid(*(np.atleast_1d(f["xyz"[k]].to_numpy()) for k in seen), indexing="ij")
    nodes = np.stack([x.ravel() for x in lists], axis=-1) if seen else np.zeros((1, 0))
    box = ds["box"].to_numpy()[0] if "box" in ds else np.full((3, 2), np.nan)
    length = box[:, 1] - box[:, 0]
    images = [(0,)] * 3
    for k in seen:
        if "xyz"[k] in ds.attrs["periodic"]:
            most = math.ceil(kernel.c / length[k]) + 1
            images[k] = range(-most, most + 1)
    total = np.zeros((len(nodes), len(places)))
    for image in itertools.product(*images):
        away = (
            nodes[:, None]
            - (places + np.where(np.array(image) == 0, 0.0, image * length))[None][..., seen]
        )
        q = np.linalg.norm(away, axis=-1)
        total += kernel(q) if seen else 1.0
    averaged = [a for a in ds.attrs["plane"] if a not in f.coords]
    layer = 1.0 if ds.attrs["dimension"] == 3 else depth(ds)
    return total / layer / np.prod([extent.get(a, length["xyz".index(a)]) for a in averaged])


def depth(ds):
    """Thickness of a layer: the extent of the box across it where that is finite, else the largest diameter."""
    (across,) = set("xyz") - set(ds.attrs["plane"])
    length = np.ptp(ds["box"].to_numpy()[0, "xyz".index(across)]) if "box" in ds else np.inf
    return float(ds.attrs.get("thickness", length if np.isfinite(length) else ds.attrs["dmax"]))
