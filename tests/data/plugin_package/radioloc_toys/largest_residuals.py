"""Result: the largest residual of each path, m."""

from dataclasses import dataclass

from radioloc.results import Card, Field, Result, ResultType, Table


@dataclass(frozen=True)
class LargestResiduals(Result):
    name: str
    largest_m: dict[str, float]
    limit_m: float

    @property
    def is_usable(self):
        return max(self.largest_m.values()) <= self.limit_m

    def card(self):
        status = "within the limit" if self.is_usable else f"beyond {self.limit_m} m"
        rows = [(path, f"{value:.2f}") for path, value in self.largest_m.items()]
        return Card((Field("status", (status,)), Field("largest", heading=("path", "m"), rows=rows)))

    def to_dict(self):
        return {"name": self.name, "largest_m": self.largest_m, "limit_m": self.limit_m}

    def files(self):
        columns = {"path": [*self.largest_m], "largest_m": [*self.largest_m.values()]}
        return {"largest.json": self.to_dict(), "largest.csv": Table(columns, {"largest_m": 3})}


LARGEST_RESIDUALS = ResultType(
    "largest_residuals", LargestResiduals, ("largest_residuals",), ("largest.json", "largest.csv")
)
