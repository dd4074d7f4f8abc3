"""QOCOGEN: C code generated for one pattern of zeros, with the method of QOCO (Chari and Açıkmeşe 2025).

Generation and compilation are part of binding and not timed. The code is kept for later programs with the same pattern, which
get their numbers by the generated update functions. The code unrolls the factorisation, so that its size limits the programs.
Compiler options are those of the generated CMake file. Settings are QOCOGEN's own, but for the tolerances.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import io
import subprocess
from typing import Any

import numpy as np
import qocogen
from scipy import sparse

from graspforce.bench.adapter import TOLERANCE, BoundSolver, SolverResult, SolverStatus, make_result
from graspforce.bench.generated_code import as_pointer, code_folder, find_compiler
from graspforce.core.errors import UnsupportedProblem
from graspforce.force.cone_program import ConicProgram

PACKAGE = "qocogen"
EXACT_CONES = True
WARM_START = False

_MAX_VARIABLES, _MAX_ROWS = 40, 100  # larger code takes more than ten seconds to compile
_COMPILER = find_compiler("QOCOGEN")
_SOURCES = ("qoco_custom.c", "cone.c", "utils.c", "ldl.c", "kkt.c", "entry.c")
_STATUS = {1: SolverStatus.SOLVED, 2: SolverStatus.SOLVED}  # solved, and solved to the looser tolerance
_ENTRY = """
#include "qoco_custom.h"
int solve_numbers(double* P, double* c, double* A, double* b, double* G, double* h, double tolerance,
                  double* x, double* y, double* z, int* iterations) {
   static Workspace work;
   set_default_settings(&work);
   load_data(&work);
   update_P(&work, P); update_c(&work, c); update_A(&work, A);
   update_b(&work, b); update_G(&work, G); update_h(&work, h);
   if (tolerance > 0.0) { work.settings.abstol = tolerance; work.settings.reltol = tolerance; }
   qoco_custom_solve(&work);
   for (int i = 0; i < work.n; ++i) { x[i] = work.sol.x[i]; }
   for (int i = 0; i < work.p; ++i) { y[i] = work.sol.y[i]; }
   for (int i = 0; i < work.m; ++i) { z[i] = work.sol.z[i]; }
   *iterations = work.sol.iters;
   return work.sol.status;
}
"""


def bind(program: ConicProgram, settings: str) -> BoundSolver:
    """Bind the code for the pattern of the program, generated and compiled if it is new.

    Args:
        program: program to solve.
        settings: accuracy settings, a key of `TOLERANCE`.

    Raises:
        UnsupportedProblem: the program is so large that its code would take long to compile.
    """
    rows = len(program.d) + len(program.r)
    if len(program.q) > _MAX_VARIABLES or rows > _MAX_ROWS:
        limit = f"code is compiled for at most {_MAX_VARIABLES} variables and {_MAX_ROWS} rows"
        raise UnsupportedProblem(f"{len(program.q)} variables and {rows} rows: {limit}")
    P, A = sparse.csc_matrix(np.triu(program.P)), sparse.csc_matrix(program.A)
    G, h = sparse.csc_matrix(np.vstack([program.C, program.S])), np.concatenate([program.d, program.r])
    solve = _compiled_function(program, P, A, G, h)
    numbers = [np.ascontiguousarray(values, dtype=np.float64) for values in (P.data, program.q, A.data, program.b, G.data, h)]
    x, y, z = (np.zeros(size) for size in (len(program.q), len(program.b), len(h)))
    iterations, tolerance = ctypes.c_int(), TOLERANCE[settings] or 0.0
    arguments = [*map(as_pointer, numbers), ctypes.c_double(tolerance), *map(as_pointer, (x, y, z)), ctypes.byref(iterations)]

    def run(start: Any) -> Any:
        return solve(*arguments), numbers

    def read(output: Any) -> SolverResult:
        status = _STATUS.get(output[0], SolverStatus.NO_ANSWER)  # QOCO has no status for infeasible problems
        return make_result(program, status, x, -y, z[: len(program.d)], iterations.value)

    return BoundSolver(run, read)


def _compiled_function(program: ConicProgram, P: Any, A: Any, G: Any, h: Any) -> Any:
    """Return the C function for the pattern of a program."""
    patterns = [part for matrix in (P, A, G) for part in (matrix.indptr, matrix.indices)]
    sizes = (len(program.q), len(program.b), len(program.d), *program.cones)
    name = hashlib.sha256(b"".join(part.tobytes() for part in patterns) + repr(sizes).encode()).hexdigest()[:16]
    folder = code_folder("qocogen") / name
    library = folder / "solver.so"
    if not library.exists():
        cones = np.array(program.cones, dtype=np.int32)
        size = (len(program.q), len(h), len(program.b))
        parts = (P if P.nnz else None, program.q, A, program.b, G, h)
        with contextlib.redirect_stdout(io.StringIO()):
            qocogen.generate_solver(*size, *parts, len(program.d), len(cones), cones, str(folder.parent), name)
        (folder / "entry.c").write_text(_ENTRY, encoding="utf-8")
        options = ["-O3", "-march=native", "-w", "-shared", "-fPIC", "-DDISABLE_PRINTING"]
        subprocess.run([_COMPILER, *options, "-o", str(library), *_SOURCES, "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(library)).solve_numbers
