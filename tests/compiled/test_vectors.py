"""Vectors compute, lane by lane, what numpy computes; and what compilers make of the loop over clusters everywhere."""

import math
import re
from functools import cache

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from cluster_scenes import agree, pair_laws
from processes import ended
from references import liquid
from wrong_calls import assert_answered

import minimd as md
from minimd.core.compiled.fixed_point import BIAS, biased_product
from minimd.core.compiled.kernels import kernel, scalar
from minimd.core.compiled.machine import restrict_features
from minimd.core.compiled.simd import bits_from_mask, broadcast, fma, lane, load, select, store, total, with_lane
from minimd.core.compiled.simd.vector import Lanes4, Lanes8, count, register_bits
from minimd.core.compiled.threads import OTHERWISE, Worker, no_counts, run_operations
from minimd.core.forces.cluster_loop import add_cluster_forces
from minimd.core.forces.cluster_term import ClusterTerm
from minimd.core.forces.options import Options
from minimd.core.forces.pair_list_term import PairListTerm
from minimd.core.neighbors import cluster_list
from minimd.core.potentials.term import FORCES

TYPES = [np.float64, np.float32, np.int32]
FLOATS = TYPES[:2]
VECTORS = [
    pytest.param(kind, lanes, id=f"{lanes.size}-{kind.__name__}", marks=() if is_usual else pytest.mark.slow)
    for kind in TYPES
    for lanes, is_usual in ((Lanes4(), False), (Lanes8(), kind != np.float32))
]
LAW = md.LennardJones(1.0, 1.0, 2.5, "truncated")
X86, ARM = "x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"
PROCESSORS = {  # triple, name, lanes, division in full-width registers
    "Zen 3": (X86, "znver3", Lanes4, r"vdivpd\s.*%ymm"),
    "Haswell": (X86, "haswell", Lanes4, r"vdivpd\s.*%ymm"),
    "Neoverse": (ARM, "neoverse-n1", Lanes4, r"fdiv\s+v\d+\.2d"),
    "AVX-512": (X86, "icelake-server", Lanes8, r"vdivpd\s.*%zmm"),  # compiles the loop once more
}
BASIC = r"\sdivpd\s.*%xmm", r"lock\s+cmpxchgq"
PLAIN = {  # triple, name, division of two numbers at a time, exchange of a counter
    "x86-64 without AVX": (X86, "x86-64", *BASIC), "Windows": ("x86_64-pc-windows-msvc", "x86-64", *BASIC),
    "ARM": (ARM, "generic", r"fdiv\s+v\d+\.2d", "stlxr"), "Mac": ("arm64-apple-macos", "apple-m1", r"fdiv\.2d", "casa"),
}  # fmt: skip
DIVISION = r"v?fdiv\s+v|vdivpd"
LANE_BY_LANE = r"vpinsr|vpextr|vinsertps|vpermilp|vunpck|mov\s+v\d+\.d\[|\bins\s"
SCALAR = r"v(?:add|sub|mul|div)s[sd]\s|f(?:add|sub|mul|div)\s+d\d"
STACK, OF_FRAME, INTO_FRAME = r"\(%rsp\)|\[sp", r"\(%rbp\)", r"%rbp$"  # a register if the loop itself changes it


def numbers(kind, n, seed=0):
    rng = np.random.default_rng(seed)
    return rng.integers(-50, 50, n, dtype=np.int32) if kind == np.int32 else rng.uniform(0.5, 4.0, n).astype(kind)


@scalar
def of_all_types(x, y):
    z = x
    z += y
    z -= y * y
    z *= x
    return x + y, x - y * y, x * y - x, z


@scalar
def of_floats(x, y):
    return (
        *(x / y, 1.0 / x + 2 * y - 0.5, -x, math.sqrt(x), np.sqrt(y), abs(x - y), np.floor(x)),
        *(max(0.5, min(x, 1.5)), min(max(x, y), 2.5), select(x < y, x, 7.0)),
        *(select((x >= y) | (x <= 1.0), x, y), select((x > y) & (x != 1.0), x, y)),
    )


@scalar
def of_doubles(x, y):
    return (*(math.tanh(x) + np.tanh(y), x**0.5, x**2, x**3, x**-1, x**2.0, x**1.5, x**-3),)


@scalar
def store_all(vectors, out, lanes):
    for k, vector in enumerate(vectors):
        store(out, k * count(lanes), vector)


@kernel
def all_types(a, b, out, lanes):
    store_all(of_all_types(load(a, 0, lanes), load(b, 0, lanes)), out, lanes)


@kernel
def floats(a, b, out, lanes):
    store_all(of_floats(load(a, 0, lanes), load(b, 0, lanes)), out, lanes)


@kernel
def doubles(a, b, out, lanes):
    store_all(of_doubles(load(a, 0, lanes), load(b, 0, lanes)), out, lanes)


def check(kernel, function, a, b, lanes, rel=0.0):
    expected = np.array([function(x, y) for x, y in zip(a, b, strict=True)]).T.astype(a.dtype)
    out = np.zeros(expected.size, a.dtype)
    kernel(a, b, out, lanes)
    assert out.reshape(expected.shape) == pytest.approx(expected, rel=rel, abs=0.0)


@pytest.mark.parametrize(("kind", "lanes"), VECTORS)
def test_what_is_done_to_vectors_is_done_lane_by_lane(kind, lanes):
    a, b = numbers(kind, lanes.size), numbers(kind, lanes.size, 1)
    check(all_types, of_all_types, a, b, lanes)
    if kind in FLOATS:
        check(floats, of_floats, a, b, lanes)
    if kind == np.float64 and lanes.size == 4:
        check(doubles, of_doubles, a, b, lanes, rel=1e-15)  # the rounding is the library's


@kernel
def elementary(x, y, out):
    for k in range(0, x.size, 8):
        a, b = load(x, k, 8), load(y, k, 8)
        finite = select(abs(a) < np.inf, a, 2.0)
        for row, found in enumerate((np.sin(a), math.cos(a), np.exp(a), math.log(a), np.arctan2(b, finite))):
            store(out, row * x.size + k, found)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 40.0, 1e5, 1e9])
def test_elementary_functions_have_all_their_digits_and_end_as_those_of_numpy_do(scale):
    """To two units in the last place, numpy's own included to three; of angles only those of finite numbers."""
    rng, special = np.random.default_rng(0), [0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 710.0, -746.0]
    x, y = scale * rng.uniform(-1.0, 1.0, (2, 4000))
    x[:8], y[:8] = special, [0.0, -1.0, 0.0, 1.0, 1.0, 1.0, np.nan, 1e-300]
    out = np.zeros((5, x.size))
    elementary(x, y, out.reshape(-1))
    with np.errstate(all="ignore"):
        angle = np.arctan2(y, np.where(np.abs(x) < np.inf, x, 2.0))
        expected = np.array([np.sin(x), np.cos(x), np.exp(x), np.log(x), angle])
        far = np.abs(out - expected) > 3.0 * np.spacing(np.abs(expected))
    assert np.array_equal(np.isnan(out), np.isnan(expected))
    assert (out == expected)[~np.isfinite(expected) & ~np.isnan(expected)].all()
    assert not far.any()


def test_what_is_too_small_counts_as_zero():
    out = np.zeros((5, 8))
    elementary(np.array([1e-310, -709.0] * 4), np.ones(8), out.reshape(-1))
    assert np.array_equal([out[3, ::2], out[2, 1::2]], [[-np.inf] * 4, [0.0] * 4])


@kernel
def looked_into(a, out):
    x = load(a, 0, 8)
    store(out, 0, select(x > 2.0, x, 0.0))
    store(out, 8, fma(x, x, broadcast(-1.0, x)))
    return bits_from_mask(x > 2.0), total(x), lane(x, 5), total(with_lane(x, 2, 100.0))


@pytest.mark.parametrize("kind", FLOATS)
def test_masks_lanes_and_sums_and_a_multiply_add_that_rounds_once(kind):
    a, out, small = numbers(kind, 8), np.zeros(16, kind), kind(2.0**-30 if kind == np.float64 else 2.0**-13)
    bits, sum_, fifth, changed = looked_into(a, out)
    assert np.array_equal(out[:8], np.where(a > 2.0, a, 0.0).astype(kind))
    assert bits == sum(1 << k for k in range(8) if a[k] > 2.0)
    pairs = a.reshape(2, 4).sum(axis=0)
    assert (sum_, fifth) == ((pairs[0] + pairs[2]) + (pairs[1] + pairs[3]), a[5])
    assert changed == pytest.approx(a.sum() - a[2] + 100.0, rel=1e-5)
    looked_into(np.full(8, 1 + small), out)
    assert np.array_equal(out[8:], np.full(8, 2 * small + small * small))


@kernel
def rounded_products(a, b, wholes):
    for k in range(len(a)):
        wholes[k] = biased_product(a[k], b[k]) - BIAS
    products = biased_product(load(a, 0, 4), load(b, 0, 4)) - BIAS
    for k in range(4):
        wholes[4 + k] = lane(products, k)


def test_a_product_on_the_grid_is_rounded_once():
    """2²⁵ + ½ + 2⁻²⁹ is nearer to 2²⁵ + 1; rounded to float64 first, it is as near to 2²⁵, which is even."""
    a = np.array([1.0, -1.0, 1.0, 3.0]) * [2**27 + 1, 2**27 + 1, 2**27, 0.5]
    b = np.array([2**27 + 1, 2**27 + 1, 2**27 + 1, 2**29 * 5.0]) * 2.0**-29
    wholes = np.zeros(8, np.int64)
    rounded_products(a, b, wholes)
    assert [*wholes] == 2 * [2**25 + 1, -(2**25) - 1, 2**25, 8]


@pytest.mark.slow  # compiles the kernels of both widths; those of this processor are compared with pairs in test_lists
@pytest.mark.parametrize("kind", [Lanes4, Lanes8])
def test_vectors_of_any_width_give_the_same_physics(monkeypatch, kind):
    monkeypatch.setattr(cluster_list, "lanes_for", lambda: kind())
    system = liquid(5)
    laws = pair_laws(system, [LAW])
    agree(ClusterTerm(system, laws, Options(threads=1)), PairListTerm(system, laws, Options(skin=0.0)), system)


@pytest.mark.slow
@pytest.mark.parametrize("chosen", ["sse", "avx2", "avx512"])
def test_older_vectors_can_be_chosen_by_their_names(chosen):
    code = "from minimd.core.compiled.simd import vector as v; print(v.register_bits(), v.lanes_for().size)"
    bits, n_lanes = map(int, ended("-c", code, MINIMD_VECTORS=chosen).stdout.split())
    assert bits == min({"sse": 128, "avx2": 256, "avx512": 512}[chosen], register_bits())
    assert n_lanes == (8 if bits == 512 else 4)
    assert_answered(lambda: restrict_features("avx3"), ValueError, "MINIMD_VECTORS", "avx3", "sse")


@cache
def code(kind):

    @numba.njit(error_model="numpy")
    def loop(arrays, law, parameters, sums):
        add_cluster_forces(0, arrays, law, parameters, sums, ())

    system = liquid(3)
    term = ClusterTerm(system, pair_laws(system, [LAW]), Options(threads=1))
    term.list.ready(system.positions, system.cell)
    term._arrange(system)
    ((law, parameters),), sums, arrays = *term._work_of(FORCES), term.list.arrays
    arrays = arrays._replace(clusters=arrays.clusters._replace(lanes=kind()))
    loop.compile(tuple(map(numba.typeof, (arrays, law, parameters, sums))))
    return loop.inspect_llvm(loop.signatures[-1])


@cache
def code_of_programs():
    """The kernel that shares out operations among threads: scalars, and counters that threads exchange."""
    loop = numba.njit(error_model="numpy", nogil=True)(run_operations.py_func)
    numbers = np.zeros((1, OTHERWISE + 1), dtype=np.int64), np.zeros(1, dtype=np.int64)
    loop.compile(tuple(map(numba.typeof, (Worker(no_counts(), 0, 2), 0, *numbers))))
    return loop.inspect_llvm(loop.signatures[-1])


def translated(ir, triple, name):
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=name, opt=3)
    ir = re.sub(r"^target (?:triple|datalayout) = .*$", "", ir, flags=re.MULTILINE)
    ir = re.sub(r"(?:tail )?call i8 @llvm\.x86[^)]*\)", "add i8 0, 0", ir)  # counts of references, outside the loop
    ir = re.sub(r'"(?:target-cpu|target-features|tune-cpu)"="[^"]*"', "", ir)
    module = llvm.parse_assembly(f'target triple = "{triple}"\ntarget datalayout = "{machine.target_data}"\n' + ir)
    return machine.emit_assembly(module)


def inner_loop(assembly):
    """The lines of the shortest loop with a vector division, and how many of these: one or two for each entry."""
    no_code = re.compile(r"\s*[.#]\w*(?:p2align|cfi|loc)")
    lines = [line for line in assembly.splitlines() if line.strip() and not no_code.match(line)]
    labels = {line.split(":")[0]: k for k, line in enumerate(lines) if re.match(r"\.\w+:", line)}
    jump = re.compile(r"\s+(?:j\w+|b\.\w+|cbn?z\s+\w+,|tbn?z.*,)\s*(\.\w+)")
    ends = [(labels.get(found[1], end), end) for end, line in enumerate(lines) if (found := jump.match(line))]
    loops = [lines[start : end + 1] for start, end in ends if start <= end]
    loop = min((body for body in loops if re.search(DIVISION, "\n".join(body))), key=len)
    return loop, sum(bool(re.search(DIVISION, one)) for one in loop)


@pytest.mark.parametrize("name", [*[*PROCESSORS][:3], pytest.param("AVX-512", marks=pytest.mark.slow)])
def test_the_loop_runs_on_full_vectors_in_registers(name):
    triple, processor, kind, division = PROCESSORS[name]
    loop, n_divisions = inner_loop(translated(code(kind), triple, processor))
    text = "\n".join(loop)
    assert re.search(division, text)
    assert not re.search(f"{LANE_BY_LANE}|{SCALAR}", text)
    of_frame = [] if re.search(INTO_FRAME, text, re.MULTILINE) else re.findall(OF_FRAME, text)
    assert not re.findall(STACK, text) + of_frame
    assert len(loop) / n_divisions < 60


@pytest.mark.parametrize("place", PLAIN)
def test_kernels_compile_for_processors_and_systems_that_are_not_here(place):
    triple, processor, division, exchange = PLAIN[place]
    for ir, instruction in ((code(Lanes4), division), (code_of_programs(), exchange)):
        assembly = translated(ir, triple, processor)
        assert re.search(instruction, assembly)
        assert not re.search(r"%[yz]mm", assembly)
