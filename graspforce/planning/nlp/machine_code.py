"""Equations as machine code, where there is a C compiler; kept on disk by what the code is."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from functools import lru_cache
from pathlib import Path

import casadi as ca

from graspforce.planning.nlp.equations import Equations

_FLAGS = ("-O1", "-fPIC", "-shared")
_SECONDS = 120  # a compiler that takes longer is stuck


def cache_folder() -> Path:
    """Where compiled equations are kept: the user's own cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "graspforce" / "equations"


@lru_cache(maxsize=128)
def compile_equations(equations: Equations) -> Equations:
    """The same equations, compiled; as they are where there is no compiler, or where it fails."""
    compiler = shutil.which(os.environ.get("CC", "cc"))
    functions = (equations.value, equations.jacobian_values, equations.lagrangian_derivatives)
    if compiler is None:
        return equations
    try:
        with tempfile.TemporaryDirectory() as scratch:
            generator = ca.CodeGenerator("equations.c", {"with_header": False})
            for function in functions:
                generator.add(function)
            source = Path(generator.generate(scratch + os.sep))
            key = hashlib.sha256(source.read_bytes() + " ".join((compiler, *_FLAGS)).encode()).hexdigest()
            library = cache_folder() / f"{key}.so"
            if not library.exists():
                library.parent.mkdir(parents=True, exist_ok=True)
                made = Path(scratch) / "equations.so"
                call = [compiler, *_FLAGS, str(source), "-o", str(made), "-lm"]
                subprocess.run(call, check=True, capture_output=True, timeout=_SECONDS)
                beside = library.with_suffix(f".{os.getpid()}")
                shutil.copy(made, beside)
                beside.replace(library)  # all at once: others may be looking
        value, jacobian_values, lagrangian_derivatives = (ca.external(function.name(), str(library)) for function in functions)
    except (OSError, subprocess.SubprocessError, RuntimeError):
        return equations
    return Equations(equations.name, value, jacobian_values, lagrangian_derivatives, equations.jacobian, equations.hessian)
