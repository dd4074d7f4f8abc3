"""Write the batches of ten thousand problems: ``python -m benchmarks.write_batches [KIND …]``, in a checkout (extra ``bench``).

Each member gets its answer as in `benchmarks.write_collections`: an optimum on which two solvers with certified solutions
agree to 1e-6, or a verified proof of infeasibility.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rich.progress import track

from benchmarks.write_collections import solve_record
from graspforce.problems.batches import PROOF_FIELDS, TOLERANCE
from graspforce.problems.case import Case, ExpectedOptimum
from graspforce.problems.derivations.records import Record
from graspforce.problems.generators.batch import COUNT, KINDS, UNITS, make_batch

FOLDER = Path(__file__).parents[1] / "problems" / "batch"


def main() -> None:
    """Write the given batches, or all."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.write_batches", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)}; all by default")
    for kind in parser.parse_args().kinds or KINDS:
        source = make_batch(kind)
        objectives, proofs = np.full(COUNT, np.nan), {}
        for i in track(range(COUNT), description=f"{kind:8}"):
            objective, proof = answer({**source.record, "wrench": (source.loads[i] * UNITS).tolist()})
            if proof is None:
                objectives[i] = objective
            else:
                proofs[i] = proof
        rows = np.vstack([np.zeros((0, _proof_size(source.record))), *(proofs[i] for i in sorted(proofs))])
        numbers = {"loads": source.loads, "objectives": objectives, "infeasible": np.array(sorted(proofs), dtype=np.int32)}
        np.savez_compressed(FOLDER / f"{kind}.npz", **numbers, proofs=rows)
        print(f"{kind}: {len(proofs)} of {COUNT} infeasible, {(FOLDER / f'{kind}.npz').stat().st_size / 1e3:.0f} kB")


def _proof_size(record: Record) -> int:
    """Return the number of multipliers of a problem in `PROOF_FIELDS`."""
    return 6 + 2 * len(record["contacts"]) + 2 * len(record.get("hand", {}).get("bias_torque", ()))


def answer(record: Record) -> tuple[float, np.ndarray | None]:
    """Return the optimum of a problem, or the multipliers that prove it infeasible, in the order of `PROOF_FIELDS`.

    Args:
        record: record of the problem.

    Raises:
        RuntimeError: no two solvers agree to `TOLERANCE`, and there is no valid proof.
    """
    known = Case.from_dict(solve_record(record)).expected
    if not isinstance(known, ExpectedOptimum):
        return float("nan"), np.concatenate([getattr(known.proof, name) for name in PROOF_FIELDS])
    if known.tolerance > TOLERANCE:
        raise RuntimeError(f"{record['name']}: optimum known to {known.tolerance:.0e} only")
    return known.objective, None


if __name__ == "__main__":
    main()
