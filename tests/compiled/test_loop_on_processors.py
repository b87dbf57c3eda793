"""The loop over clusters on every processor: the vectors that suit it, and what the compiler makes of it for others."""

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
from minimd.compiled.machine import restrict_features
from minimd.compiled.simd import vector as lanes
from minimd.compiled.threads import OTHERWISE, Worker, no_counts, run_operations
from minimd.forces.cluster_loop import add_cluster_forces
from minimd.forces.cluster_term import ClusterTerm
from minimd.forces.options import Options
from minimd.forces.pair_list_term import PairListTerm
from minimd.neighbors import cluster_list
from minimd.potentials.term import FORCES

LAW = md.LennardJones(1.0, 1.0, 2.5, "truncated")
X86, ARM = "x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu"
PROCESSORS = {  # triple, name, lanes, division in full-width registers
    "Zen 3": (X86, "znver3", lanes.Lanes4, r"vdivpd\s.*%ymm"),
    "Haswell": (X86, "haswell", lanes.Lanes4, r"vdivpd\s.*%ymm"),
    "Neoverse": (ARM, "neoverse-n1", lanes.Lanes4, r"fdiv\s+v\d+\.2d"),
    "AVX-512": (X86, "icelake-server", lanes.Lanes8, r"vdivpd\s.*%zmm"),  # compiles the loop once more
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


@pytest.mark.slow  # compiles the kernels of both widths; those of this processor are compared with pairs in test_lists
@pytest.mark.parametrize("kind", [lanes.Lanes4, lanes.Lanes8])
def test_vectors_of_any_width_give_the_same_physics(monkeypatch, kind):
    monkeypatch.setattr(cluster_list, "lanes_for", lambda: kind())
    system = liquid(5)
    laws = pair_laws(system, [LAW])
    agree(ClusterTerm(system, laws, Options(threads=1)), PairListTerm(system, laws, Options(skin=0.0)), system)


@pytest.mark.slow
@pytest.mark.parametrize("chosen", ["sse", "avx2", "avx512"])
def test_older_vectors_can_be_chosen_by_their_names(chosen):
    code = "from minimd.compiled.simd.vector import register_bits, lanes_for; print(register_bits(), lanes_for().size)"
    bits, n_lanes = map(int, ended("-c", code, MINIMD_VECTORS=chosen).stdout.split())
    assert bits == min({"sse": 128, "avx2": 256, "avx512": 512}[chosen], lanes.register_bits())
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
    for ir, instruction in ((code(lanes.Lanes4), division), (code_of_programs(), exchange)):
        assembly = translated(ir, triple, processor)
        assert re.search(instruction, assembly)
        assert not re.search(r"%[yz]mm", assembly)
