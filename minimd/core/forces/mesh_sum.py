"""The smooth part of Coulomb's law on a mesh: the waves of wave_sum.py, by Fourier transforms of charges on its points.

    Q(m) = Σ qⱼ φ(m − xⱼ),  S(k) = Q̂(k)/φ̂(k),  v(m) = Σ_k L̂(k)/(V φ̂(k)²) Q̂(k) exp(−i k·m),
    U = ½ Σ_m Q(m) v(m) − ½ L(0) Σ qᵢ²,   F_i = −qᵢ Σ_m v(m) ∂φ(m − xᵢ)/∂rᵢ

V is the volume, x are positions in units of the spacing of points, φ is a product of three windows: see mesh_window.py.
Forces are minus the gradient of this energy, less their sum, of which each atom bears a share by its mass: that is the
motion under U where the center of mass is held in its place. Charges are put on the planes of the mesh by chunks that
own them, row by row of where atoms start: the same bits for any number of threads. Those of the transforms depend on
the builds of numpy and scipy.

T. Darden, D. York, L. Pedersen, J. Chem. Phys. 98, 10089 (1993); U. Essmann et al., ibid. 103, 8577 (1995).
"""

from collections import namedtuple
from collections.abc import Iterator
from math import pi, prod

import numpy as np

from minimd.core.compiled.by_address import ByAddress
from minimd.core.compiled.kernels import called_kernel, scalar
from minimd.core.compiled.program import GO_ON, Operation, in_python, operation, share_of
from minimd.core.compiled.simd import broadcast, fma, load, store, total, zeros
from minimd.core.compiled.simd.vector import Lanes8, Lanes16, count
from minimd.core.forces.mesh_window import Window, windows
from minimd.core.forces.wave_sum import MOST_CELLS, ChargeSum, WaveSum, virials_of
from minimd.core.potentials.prolates import Split
from minimd.core.potentials.term import FORCES, Target
from minimd.core.structure.arrays import Array
from minimd.core.structure.system import System
from minimd.core.structure.vectors import across, along

MOST_SLABS = 16  # of planes
# measured [ns]: of an atom, for each row that it sees, and for a vector of eight points; of a point of the mesh; of all
PER_ATOM = 30.0
PER_ROW = 2.0
PER_POINT = 7.0
PER_SUM = 40_000.0
PER_WAVE = 0.18  # of an atom, in a sum wave by wave
ROOM = 1.02  # for a cell that becomes larger
MOST_POINTS = 2**27  # of a mesh: some gigabytes
IN_A_BLOCK = 256  # atoms, in numpy


class Mesh(
    ByAddress,
    namedtuple(
        "Mesh",
        "positions charges shares inverse shape pieces starts edges seen order begins points sums forces width",
    ),
):
    """What the sum works on.

    positions : (N, 3) [length].
    charges : (N,) [√(energy · length)].
    shares : (N,), masses over their sum.
    inverse : (3, 3) of the lattice [1/length].
    shape : (5,) int, points in each direction; in a row, with those that repeat its beginning; that an atom sees.
    pieces : (D, width) of the window.
    starts : (N, 3) int, the first points that atoms see.
    edges : (N, 3) t of the pieces.
    seen : (N · 6 · width,) φ and dφ/dt of each atom, in order, in the three directions.
    order : (N,) int, atoms by the row where they start, so that those after one another see nearly the same points.
    begins : (rows + 1,) int, of each row in order.
    points : of the mesh, row by row.
    sums : (chunks, 3) of forces.
    forces : (N, 3) output.
    width : points of a row that are added at once.
    """


@called_kernel
def find_points(mesh, chunk):
    """The first points that the atoms of a chunk see.

    mesh : Mesh; starts and edges of these atoms are overwritten.
    chunk : number of the chunk.
    """
    n = mesh.charges.size
    n_chunks = mesh.sums.shape[0]
    shape = mesh.shape

    first, last = share_of(chunk, n_chunks, n)

    for i in range(first, last):
        position = mesh.positions[i, 0], mesh.positions[i, 1], mesh.positions[i, 2]
        for d in range(3):
            s = along(position, mesh.inverse, d)
            edge = shape[d] * (s - np.floor(s)) - 0.5 * shape[4]
            first = np.ceil(edge)
            mesh.edges[i, d] = 2.0 * (first - edge) - 1.0
            mesh.starts[i, d] = int(first) % shape[d]

    return GO_ON


@called_kernel
def sort_atoms(mesh, _chunk):
    """Atoms by the row where they start: order and begins, by counting; equal ones keep their order."""
    begins = mesh.begins
    n_rows = mesh.shape[1]
    for k in range(begins.size):
        begins[k] = 0
    for i in range(mesh.order.size):
        begins[mesh.starts[i, 0] * n_rows + mesh.starts[i, 1] + 1] += 1
    for k in range(begins.size - 1):
        begins[k + 1] += begins[k]

    for i in range(mesh.order.size):
        row = mesh.starts[i, 0] * n_rows + mesh.starts[i, 1]
        mesh.order[begins[row]] = i
        begins[row] += 1

    for k in range(begins.size - 1, 0, -1):
        begins[k] = begins[k - 1]
    begins[0] = 0
    return GO_ON


@called_kernel
def see_points(mesh, chunk):
    """How the atoms of a chunk, in order, see their points.

        φ(m − x) and its slope, from the pieces: a polynomial of t for each point, by Horner's rule

    mesh : Mesh; seen of these atoms is overwritten.
    """
    n = mesh.charges.size
    n_chunks = mesh.sums.shape[0]
    width = np.uintp(count(mesh.width))

    first, last = share_of(chunk, n_chunks, n)

    for place in range(first, last):
        i = mesh.order[place]
        for d in range(3):
            t = broadcast(mesh.edges[i, d], zeros(mesh.width))
            value = slope = zeros(mesh.width)
            for k in range(mesh.pieces.shape[0] - 1, -1, -1):
                slope = fma(slope, t, value)
                value = fma(value, t, load(mesh.pieces[k], 0, mesh.width))
            at = np.uintp(6 * place + 2 * d) * width
            store(mesh.seen, at, value)
            store(mesh.seen, at + width, slope)

    return GO_ON


@called_kernel
def put_charges(mesh, chunk):
    """Charges on the points of some planes, from all atoms that see them.

        Q(m) = Σ qⱼ φ(m − xⱼ)

    A chunk owns its planes, so that no two write to the same point. The ends of rows, which repeat their beginnings,
    are added to them at last.
    """
    shape = mesh.shape
    n_planes = mesh.shape[0]
    n_chunks = plane_chunks(mesh.shape)
    first, last = share_of(chunk, n_chunks, n_planes)
    size = shape[1] * shape[3]
    for k in range(first * size, last * size):
        mesh.points[k] = 0.0
    is_alone = n_chunks == 1

    for start in range(first if is_alone else first - shape[4] + 1, last):
        plane = start if start >= 0 else start + n_planes
        begin = max(0, first - start)
        end = shape[4] if is_alone else min(shape[4], last - start)
        row = plane * shape[1]
        for k in range(mesh.begins[row], mesh.begins[row + shape[1]]):
            _put_one(mesh, k, begin, end)

    for row in range(first * shape[1], last * shape[1]):
        at = row * shape[3]
        for k in range(shape[2], shape[3]):
            mesh.points[at + k % shape[2]] += mesh.points[at + k]

    return GO_ON


@scalar
def plane_chunks(shape):
    """Chunks of planes, each at least as many as an atom sees, or one."""
    return max(1, min(MOST_SLABS, shape[0] // shape[4]))


@scalar
def _put_one(mesh, place, begin, end):
    """The charge of an atom on the planes begin to end of those that it sees.

    place : of the atom in order.
    begin, end : of the planes, 0 for the first that it sees.
    """
    shape = mesh.shape
    width = np.uintp(count(mesh.width))
    seen = mesh.seen
    i = mesh.order[place]
    at = np.uintp(6 * place) * width
    window = mesh.charges[i] * load(seen, at + np.uintp(4) * width, mesh.width)

    for k in range(begin, end):
        plane = (mesh.starts[i, 0] + k) % shape[0]
        on_plane = seen[at + np.uintp(k)] * window
        row = mesh.starts[i, 1]

        for j in range(shape[4]):
            point = _point_at(mesh, i, plane, row)
            weight = seen[at + np.uintp(j) + width + width]
            points = load(mesh.points, point, mesh.width)
            store(mesh.points, point, fma(on_plane, weight, points))
            row = row + 1 if row + 1 < shape[1] else 0


@scalar
def _point_at(mesh, i, plane, row):
    """Where the points begin that atom i sees in a row of a plane."""
    shape = mesh.shape
    return np.uintp((plane * shape[1] + row) * shape[3] + mesh.starts[i, 2])


@called_kernel
def push_from_points(mesh, chunk):
    """forces += those of the mesh on a chunk of atoms, in order, and their sum.

        F = −q Σ_m v(m) ∂φ(m − x)/∂r: along each direction the slope of its window times the two other windows

    mesh : Mesh; sums[chunk] is overwritten.
    """
    n = mesh.charges.size
    n_chunks = mesh.sums.shape[0]
    shape = mesh.shape
    seen = mesh.seen
    width = np.uintp(count(mesh.width))
    nothing = zeros(mesh.width)
    for d in range(3):
        mesh.sums[chunk, d] = 0.0

    first, last = share_of(chunk, n_chunks, n)

    for place in range(first, last):
        i = mesh.order[place]
        at = np.uintp(6 * place) * width
        at_y = at + width + width
        along_x = nothing
        along_y = nothing
        along_z = nothing

        for k in range(shape[4]):
            plane = (mesh.starts[i, 0] + k) % shape[0]
            row = mesh.starts[i, 1]
            value = nothing
            slope = nothing

            for j in range(shape[4]):
                point = _point_at(mesh, i, plane, row)
                points = load(mesh.points, point, mesh.width)
                value = fma(points, seen[at_y + np.uintp(j)], value)
                slope = fma(points, seen[at_y + width + np.uintp(j)], slope)
                row = row + 1 if row + 1 < shape[1] else 0

            on_plane = seen[at + np.uintp(k)]
            across_plane = seen[at + width + np.uintp(k)]
            along_x = fma(value, across_plane, along_x)
            along_y = fma(slope, on_plane, along_y)
            along_z = fma(value, on_plane, along_z)

        window = load(seen, at_y + width + width, mesh.width)
        bend = load(seen, at_y + width + width + width, mesh.width)
        q2 = 2.0 * mesh.charges[i]  # the slope of t is −2
        fa = q2 * shape[0] * total(along_x * window)
        fb = q2 * shape[1] * total(along_y * window)
        fc = q2 * shape[2] * total(along_z * bend)

        for d in range(3):
            f = across(mesh.inverse, d, (fa, fb, fc))
            mesh.forces[np.uintp(i), d] += f
            mesh.sums[chunk, d] += f

    return GO_ON


@called_kernel
def hold_center(mesh, chunk):
    """forces −= the share of each atom of a chunk in their sum: (m/Σm) Σ F, so that the center stays in its place."""
    n = mesh.charges.size
    n_chunks = mesh.sums.shape[0]

    for d in range(3):
        rest = 0.0
        for k in range(n_chunks):
            rest += mesh.sums[k, d]
        first, last = share_of(chunk, n_chunks, n)
        for i in range(first, last):
            mesh.forces[i, d] -= mesh.shares[i] * rest

    return GO_ON


def charge_sum(
    system: System,
    charges: Array,
    split: Split,
    method: str,
    is_fixed: bool,
) -> ChargeSum:
    """The sum that a method names: "waves", "mesh", or "ewald", the one that takes less time.

    Raises ValueError for a mesh in fixed-point arithmetic, or for an accuracy that no mesh reaches; and as WaveSum.
    """
    n_waves = split.largest_wave**3 * (system.volume or 0.0) / (12.0 * pi**2)
    wave_by_wave = PER_WAVE * len(system) * n_waves if n_waves <= MOST_CELLS else np.inf
    if is_fixed or method == "waves":
        wave_by_wave = 0.0
    times = {}
    if method == "mesh" or wave_by_wave > PER_SUM:
        for window in windows(split):
            n_vectors = window.points**2 * -(-window.points // Lanes8.size)
            of_atoms = len(system) * (PER_ATOM + PER_ROW * n_vectors)
            times[window] = PER_SUM + PER_POINT * prod(shape_for(system, window)) + of_atoms

    best = min(times, key=times.__getitem__, default=None)
    if best is not None:
        shape = shape_for(system, best)
        if prod(shape) > MOST_POINTS:
            raise ValueError(
                f"cutoff of Coulomb must be larger; {split.cutoff:.3g} needs a mesh of "
                f"{' x '.join(map(str, shape))} points; at most {MOST_POINTS} are allowed"
            )

    if method == "mesh" and (best is None or is_fixed):
        limit = "in fixed-point arithmetic" if is_fixed else f"at an accuracy of {split.bound:.1g}"
        raise ValueError(f'method of Coulomb must be "waves" or "ewald" {limit}; method = "mesh"')
    if best is None or (method != "mesh" and wave_by_wave < times[best]):
        return WaveSum(system, charges, split)
    return MeshSum(system, charges, split, best)


def shape_for(system: System, window: Window) -> tuple[int, int, int]:
    """Points in each direction: of small prime factors."""
    from scipy.fft import next_fast_len

    lengths = np.linalg.norm(system.cell.lattice, axis=1)
    a, b, c = (
        next_fast_len(int(np.ceil(ROOM * length / window.spacing)), real=True) for length in lengths
    )
    return a, b, c


class MeshSum(ChargeSum):
    """The sum of the charges of a system on a mesh.
    window : one of windows(split)."""

    def __init__(
        self,
        system: System,
        charges: Array,
        split: Split,
        window: Window,
    ) -> None:
        super().__init__(system, charges, split)
        self._window = window
        self.shape = shape_for(system, window)
        self._width = Lanes8() if window.points <= Lanes8.size else Lanes16()
        n = len(system)
        width = self._width.size
        a, b, c = self.shape
        self._pieces = window.pieces(split.bound, width)
        self._sizes = np.array([a, b, c, c + width, window.points])
        self._starts = np.zeros((n, 3), dtype=np.int64)
        self._edges = np.zeros((n, 3))
        self._order = np.zeros(n, dtype=np.int64)
        self._seen = np.zeros(6 * n * width)
        self._begins = np.zeros(a * b + 1, dtype=np.int64)
        self._points = np.zeros((a, b, c + width))
        self._shares = system.masses / system.masses.sum()
        self._sums = np.zeros((self._n_chunks, 3))
        self._repeated = np.arange(width) % c
        most = int(split.largest_wave * window.spacing * c / (2.0 * pi))
        waves = [
            np.fft.fftfreq(a, 1.0 / a),
            np.fft.fftfreq(b, 1.0 / b),
            np.arange(most + 1.0),
        ]
        self._waves = np.stack(np.meshgrid(*waves, indexing="ij"), axis=-1)
        self._amplitudes = np.zeros((a, b, most + 1), dtype=np.complex128)
        self._rows = np.zeros((a, b, c // 2 + 1), dtype=np.complex128)
        axes = zip(waves, self.shape, strict=True)
        seen = [window.transform(frequencies / size) for frequencies, size in axes]
        self._seen2 = np.einsum("i,j,k->ijk", *seen) ** 2
        self._take(system)

    @property
    def summary(self) -> str:  # type: ignore[override]
        """The sum, for the report."""
        points = " x ".join(map(str, self.shape))
        seen = f"{self._window.points}³"
        return f"mesh of {points} points, of which a charge sees {seen} ({self._said})"

    def follow(self, system: System) -> bool:
        """See Term."""
        lengths = np.linalg.norm(system.cell.lattice, axis=1)
        if (lengths > self._window.spacing * np.array(self.shape)).any():
            return False
        self._take(system)
        return True

    def operations(self, system: System, target: Target) -> Iterator[Operation]:
        """See Term."""
        mesh = Mesh(
            positions=system.positions,
            charges=self._charges,
            shares=self._shares,
            inverse=self._inverse,
            shape=self._sizes,
            pieces=self._pieces,
            starts=self._starts,
            edges=self._edges,
            seen=self._seen,
            order=self._order,
            begins=self._begins,
            points=self._points.reshape(-1),
            sums=self._sums,
            forces=target.forces,
            width=self._width,
        )
        yield operation(self._calls, find_points, mesh, self._n_chunks)
        yield operation(self._calls, sort_atoms, mesh)
        yield operation(self._calls, see_points, mesh, self._n_chunks)
        yield operation(self._calls, put_charges, mesh, plane_chunks.py_func(self._sizes))
        yield in_python(lambda: self._convolve(target.detail), is_beside=True)
        yield operation(self._calls, push_from_points, mesh, self._n_chunks)
        yield operation(self._calls, hold_center, mesh, self._n_chunks)

    def _convolve(self, detail: int) -> None:
        """From charges to potentials, in place; energy and virial, if they are wanted.

        v̂ = L̂/(V φ̂²) Q̂,   U = ½ Σ_k |Q̂|² L̂/(V φ̂²)
        """
        from scipy.fft import fftn

        points = self._points[:, :, : self.shape[2]]
        np.fft.rfft(points, out=self._rows)
        self._amplitudes[:] = self._rows[:, :, : self._amplitudes.shape[2]]
        # in place: new memory for each transform would take more time than they do
        fftn(self._amplitudes, axes=(0, 1), overwrite_x=True)
        if detail != FORCES:
            self._kept = self._amplitudes[self._used]
            half = 0.5 * self._twice * np.abs(self._kept) ** 2
            self._totals[0, 0] = half @ self._weights[self._used]
            self._totals[0, 1:] = half @ self._virials

        self._amplitudes *= self._weights
        self._fill()

    def _fill(self) -> None:
        """The points, from their transform."""
        from scipy.fft import ifftn

        length = self.shape[2]
        points = self._points[:, :, :length]
        ifftn(
            self._amplitudes,
            axes=(0, 1),
            norm="forward",
            overwrite_x=True,
        )
        np.fft.irfft(self._amplitudes, length, norm="forward", out=points)
        self._points[:, :, length:] = self._points[:, :, self._repeated]

    def _of_atoms(self) -> tuple[Array, Array]:
        """See ChargeSum."""
        shares = []
        for weights in (self._weights[self._used], *self._virials.T):
            self._amplitudes[:] = 0.0
            self._amplitudes[self._used] = weights * self._kept
            self._fill()
            shares.append(0.5 * self._charges * self._at_atoms())
        return shares[0], np.stack(shares[1:], axis=1)

    def _at_atoms(self) -> Array:
        """The potential of the points at each atom, (N,): Σ_m v(m) φ(m − x), in blocks of atoms."""
        values_and_slopes = self._seen.reshape(len(self._charges), 3, 2, -1)
        seen = values_and_slopes[:, :, 0, : self._window.points]
        n_atoms = len(seen)
        potentials = np.empty(n_atoms)
        offsets = np.arange(seen.shape[2])

        for block in np.array_split(np.arange(n_atoms), n_atoms // IN_A_BLOCK + 1):
            atoms = self._order[block]
            starts = self._starts[atoms, :, None] + offsets
            planes = starts[:, 0, :, None, None] % self.shape[0]
            rows = starts[:, 1, None, :, None] % self.shape[1]
            columns = starts[:, 2, None, None, :] % self.shape[2]
            points = self._points[planes, rows, columns]
            windows_of = seen[block].swapaxes(0, 1)
            potentials[atoms] = np.einsum("nijk,ni,nj,nk->n", points, *windows_of)

        return potentials

    def _take(self, system: System) -> None:
        """Weights for the present cell."""
        self._keep(system)
        k = 2.0 * pi * self._waves @ self._inverse.T
        k2 = (k**2).sum(axis=-1)
        self._used = np.nonzero((k2 > 0.0) & (k2 <= self._split.largest_wave**2))
        k = k[self._used]
        k2 = k2[self._used]
        spectrum, bend = self._split.spectrum(k2)
        seen2 = self._volume * self._seen2[self._used]
        weights = spectrum / seen2
        self._weights = np.zeros(self._waves.shape[:3])
        self._weights[self._used] = weights
        self._virials = virials_of(k, weights, bend / seen2)
        self._twice = np.where(self._used[2] > 0, 2.0, 1.0)  # k and −k
