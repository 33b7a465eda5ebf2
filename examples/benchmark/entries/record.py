"""Record radioloc's own entry of a case whose data must be downloaded.

python examples/benchmark/entries/record.py examples/benchmark/grail-arcs
"""

import json
import sys
from pathlib import Path

import radioloc
from radioloc.jobs.benchmark import read_cases


def main(folder):
    (case,) = read_cases(folder)
    results = {}
    for study in case.studies:
        state = radioloc.locate(study).state.to_dict()
        results[study.stem] = {
            "frame": "ICRF",
            "epoch_tdb": state["epoch_tdb"],
            "position_m": [round(value, 3) for value in state["position_m"]],
            "covariance_m2": [[round(value, 6) for value in row[:3]] for row in state["covariance"][:3]],
        }
    names = ", ".join(study.name for study in case.studies)
    entry = {"program": "radioloc", "version": radioloc.__version__, "method": names, "results": results}
    path = folder / "entries" / "radioloc.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(entry, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
