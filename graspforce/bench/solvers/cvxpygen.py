"""CVXPYgen: C code generated from a CVXPY problem (Schaller, Banjac, Diamond, Agrawal, Stellato and Boyd 2022), with ECOS.

All numbers of the program are parameters of the CVXPY problem, so that one code serves all programs with the same zeros. The
cost is ½‖Lx‖² + qᵀx with L = P^½, which has the blocks of P. ECOS is wrapped because it takes second-order cones, proves
infeasibility, and compiles with a plain C compiler. CVXPY states the quadratic cost as a cone for ECOS.

Generation and compilation are part of binding and not timed. The timed run updates all parameters by the generated functions
and solves; the first run of a code also allocates its workspace. Compiler options are those of the generated CMake file.
Settings are those of CVXPYgen, but for the tolerances.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import io
import subprocess
import warnings
from pathlib import Path
from typing import Any

import cvxpy as cp
import numpy as np
from cvxpygen import cpg
from scipy.sparse import csgraph

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.bench.generated_code import as_pointer, code_folder, find_compiler
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.cone_program import ConicProgram

PACKAGE = "cvxpygen"
EXACT_CONES = True
WARM_START = False

_MAX_VARIABLES, _MAX_ROWS = 100, 300  # the generator maps parameters to rows by dense matrices
_COMPILER = find_compiler("CVXPYgen")
_OPTIONS = ("-O3", "-w", "-fPIC")
_INCLUDE = ("include", "external/amd/include", "external/ldl/include", "external/SuiteSparse_config")
_STATUS = {0: SolverStatus.SOLVED, 10: SolverStatus.SOLVED, 1: SolverStatus.INFEASIBLE, 11: SolverStatus.INFEASIBLE}
_ENTRY = """
#include "cpg_workspace.h"
#include "cpg_solve.h"
int solve_numbers(const double* numbers, double tolerance, double* x, double* y, double* z, int* iterations) {{
   {updates}
   cpg_set_solver_default_settings();
   if (tolerance > 0.0) {{
      cpg_set_solver_feastol(tolerance); cpg_set_solver_abstol(tolerance); cpg_set_solver_reltol(tolerance);
   }}
   cpg_solve();
   {results}
   *iterations = CPG_Result.info->iter;
   return CPG_Result.info->status;
}}
"""


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind the code for the pattern of the program, generated and compiled if it is new.

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.

    Raises:
        UnsupportedProblem: the program is larger than the size for which code is generated.
    """
    rows = len(program.d) + len(program.r)
    if len(program.q) > _MAX_VARIABLES or rows > _MAX_ROWS:
        limit = f"code is generated for at most {_MAX_VARIABLES} variables and {_MAX_ROWS} rows"
        raise UnsupportedProblem(f"{len(program.q)} variables and {rows} rows: {limit}")
    matrices, patterns = _matrices(program)
    solve = _compiled_function(program, patterns)
    vectors = (program.q, program.b, program.d, program.r)
    numbers = np.concatenate([*(matrices[name][pattern] for name, pattern in patterns.items()), *vectors])
    x, y, z = (np.zeros(len(values)) for values in (program.q, program.b, program.d))
    iterations, tolerance = ctypes.c_int(), TOLERANCE[settings] or 0.0
    arguments = [as_pointer(numbers), ctypes.c_double(tolerance), *map(as_pointer, (x, y, z)), ctypes.byref(iterations)]

    def run(start: Any) -> Any:
        return solve(*arguments), numbers

    def read(output: Any) -> SolverResult:
        return make_result(program, _STATUS.get(output[0], SolverStatus.NO_ANSWER), x, -y, z, iterations.value)

    return BoundSolver(run, read)


def _matrices(program: ConicProgram) -> tuple[dict[str, np.ndarray], dict[str, tuple[np.ndarray, ...]]]:
    """Return the matrices, and the indices of their entries, row by row; both by the name of the parameter."""
    nonzero = program.P != 0
    blocks = csgraph.connected_components(nonzero, directed=False)[1]
    squares, vectors = np.linalg.eigh(program.P)
    root = vectors * np.sqrt(np.maximum(squares, 0.0)) @ vectors.T
    entries = {"L": (blocks[:, None] == blocks) & nonzero.any(axis=0)}
    matrices = {"L": root, "A": program.A, "C": program.C, "S": program.S}
    entries |= {name: matrices[name] != 0 for name in ("A", "C", "S")}
    for name in ("A", "C", "S"):
        entries[name][:1, :1] |= not entries[name].any()  # CVXPY needs an entry
    patterns = {name: np.nonzero(part) for name, part in entries.items()}
    return matrices, {name: pattern for name, pattern in patterns.items() if len(pattern[0])}


def _compiled_function(program: ConicProgram, patterns: dict[str, tuple[np.ndarray, ...]]) -> Any:
    """Return the C function for the pattern of a program."""
    sizes = (*(len(part) for part in (program.q, program.b, program.d)), *program.cones)
    parts = [name.encode() + part.tobytes() for name, pattern in patterns.items() for part in pattern]
    folder = code_folder("cvxpygen") / hashlib.sha256(b"".join(parts) + repr(sizes).encode()).hexdigest()[:16]
    library = folder / "solver.so"
    if not library.exists():
        problem = _cvxpy_problem(program, patterns)
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # CVXPY discourages the way in which CVXPYgen reads sparse parameters
            cpg.generate_code(problem, code_dir=str(folder), solver="ECOS", wrapper=False)
        code = folder / "c"
        (code / "src" / "entry.c").write_text(_entry(problem, program), encoding="utf-8")
        sources = [str(code / "src" / name) for name in ("cpg_workspace.c", "cpg_solve.c", "entry.c")]
        include = [f"-I{code / 'include'}", *(f"-I{code / 'solver_code' / name}" for name in _INCLUDE)]
        objects = map(str, _solver_objects(code / "solver_code"))
        files = [*sources, *objects, "-lm"]
        subprocess.run([_COMPILER, *_OPTIONS, "-shared", *include, "-o", str(library), *files], check=True)
    return ctypes.CDLL(str(library)).solve_numbers


def _cvxpy_problem(program: ConicProgram, patterns: dict[str, tuple[np.ndarray, ...]]) -> Any:
    """Return the program with parameters as numbers."""
    m, x = len(program.q), cp.Variable(len(program.q), name="x")
    rows = {"L": m, "A": len(program.b), "C": len(program.d), "S": len(program.r)}
    products = {name: cp.Parameter((rows[name], m), name=name, sparsity=pattern) @ x for name, pattern in patterns.items()}
    q, b = cp.Parameter(m, name="q"), cp.Parameter(len(program.b), name="b")
    cost = q @ x + (0.5 * cp.sum_squares(products["L"]) if "L" in products else 0.0)
    constraints = [products["A"] == b]  # the order of the dual variables d0 and d1
    if "C" in products:
        constraints.append(products["C"] <= cp.Parameter(len(program.d), name="d"))
    if "S" in products:
        inside, first = cp.Parameter(len(program.r), name="r") - products["S"], 0
        for size in program.cones:
            constraints.append(cp.SOC(inside[first], inside[first + 1 : first + size]))
            first += size
    return cp.Problem(cp.Minimize(cost), constraints)


def _entry(problem: Any, program: ConicProgram) -> str:
    """Return the C code that updates all parameters, solves and copies the solution."""
    entries = {one.name(): one.size if one.sparse_idx is None else len(one.sparse_idx[0]) for one in problem.parameters()}
    results = {"prim->x": len(program.q), "dual->d0": len(program.b), "dual->d1": len(program.d)}
    updates = [_loop(entries[name], f"cpg_update_{name}({{i}}*numbers++);", "i, ") for name in "LACSqbdr" if name in entries]
    copies = [
        _loop(size, f"*{target}++ = CPG_Result.{name}{{i}};", "[i]")
        for target, (name, size) in zip("xyz", results.items(), strict=True)
        if size
    ]
    return _ENTRY.format(updates="\n   ".join(updates), results="\n   ".join(copies))


def _loop(size: int, statement: str, index: str) -> str:
    """Return a C loop; CVXPYgen states a single number without index."""
    return statement.format(i="") if size == 1 else f"for (int i = 0; i < {size}; ++i) {{ {statement.format(i=index)} }}"


def _solver_objects(source: Path) -> list[Path]:
    """Return the object files of ECOS, which are the same for all patterns."""
    folder = code_folder("cvxpygen") / "objects"
    if not folder.exists():
        folder.mkdir()
        parts = [path for name in ("src", "external/amd/src", "external/ldl/src") for path in (source / name).glob("*.c")]
        files = [str(path) for path in parts if not path.name.startswith("runecos")]  # programs with a main function
        include = [f"-I{source / name}" for name in _INCLUDE]
        subprocess.run([_COMPILER, *_OPTIONS, "-c", *include, *files], cwd=folder, check=True)
    return sorted(folder.glob("*.o"))
