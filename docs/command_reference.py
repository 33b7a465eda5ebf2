"""Write the commands, options and exit statuses of docs/reference/command-line.md from the parser.

python docs/command_reference.py
"""

from pathlib import Path

from radioloc.cli.output import EXIT_STATUS
from radioloc.cli.registry import COMMANDS

PAGE = Path(__file__).parent / "reference" / "command-line.md"
BEGIN, END = "<!-- from the parser: docs/command_reference.py -->\n", "<!-- end -->\n"
MAX_NAMES = 6  # commands named in the row of an option
GUIDES = {
    "locate": "[Read the result card](../how-to/read-the-result-card.md)",
    "arcs": "[Length of the arc](../how-to/arc-length-study.md)",
    "base-map": "[Base map](../how-to/make-a-base-map.md)",
    "leave-one-out": "[Influence of stations](../how-to/read-the-result-card.md#influence-of-stations)",
    "simulate": "[Simulated tracking](simulation.md)",
    "covariance": "[Covariance analysis](../how-to/plan-tracking.md#covariance-analysis)",
    "montecarlo": "[Monte Carlo trials](../how-to/plan-tracking.md#monte-carlo-trials)",
    "visibility": "[Visibility](../how-to/plan-tracking.md#visibility)",
    "light-time": "[Light times](../how-to/light-times.md)",
    "convert": "[Table of observations](observation-table.md), [Tracking Data Messages](tdm.md)",
    "compare": "[Compare solutions](../how-to/compare-solutions.md)",
    "verify": "[Repeat a solution](#repeat-a-solution)",
    "export": "[Export](../how-to/export-and-map.md)",
    "map": "[Map](../how-to/export-and-map.md#map)",
    "score": "[Benchmark](../how-to/benchmark.md)",
    "kernels": "[Other kernels](../how-to/use-another-ephemeris.md#other-kernels)",
    "completion": "[Installation](#completion)",
    "search": "[Searches](../how-to/search.md)",
    "images": "[Descent images](../how-to/locate-by-images.md), [landmarks](../how-to/locate-by-landmarks.md)",
}
"""Pages on commands; the other commands need none."""


def reference() -> str:
    """Return the generated part of the page: tables of commands, of options and of exit statuses."""
    commands, options = [], {}
    for name, command in COMMANDS.items():
        places = [_usage(item) for item in command.arguments if not _is_option(item)]
        usage = " ".join(("radioloc", name, *places))
        guide = f" {GUIDES[name]}" if name in GUIDES else ""
        commands.append(f"| `{usage}` | {command.summary}{guide} |")
        for item in filter(_is_option, command.arguments):
            meaning = item.keywords["help"].replace("%%", "%")
            options.setdefault((_usage(item), meaning), []).append(f"`{name}`")
    rows = [
        f"| `{usage}` | {', '.join(names) if len(names) < MAX_NAMES else 'most'} | {meaning} |"
        for (usage, meaning), names in options.items()
    ]
    statuses = [f"| {status} | {meaning} |" for status, meaning in EXIT_STATUS.items()]
    tables = (
        ("## Commands", "| command | purpose |", "| --- | --- |", *commands),
        ("## Options", "| option | of | meaning |", "| --- | --- | --- |", *rows),
        ("## Exit status", "| exit status | meaning |", "| --- | --- |", *statuses),
    )
    return "\n\n".join("\n".join((table[0], "", *table[1:])) for table in tables) + "\n"


def _is_option(item) -> bool:
    return item.names[0].startswith("-")


def _usage(item) -> str:
    """Return the name of an option and the placeholders of an argument."""
    keywords = item.keywords
    places = keywords.get("metavar") or ([] if _is_option(item) else item.names)
    if "choices" in keywords:
        places = ["\\|".join(keywords["choices"])]
    words = " ".join([*item.names * _is_option(item), *([places] if isinstance(places, str) else places)])
    return {"?": f"[{words}]", "*": f"[{words} ...]", "+": f"{words} [...]"}.get(keywords.get("nargs"), words)


def updated(text: str) -> str:
    """Return the page with its generated part replaced."""
    before, _, others = text.partition(BEGIN)
    return f"{before}{BEGIN}\n{reference()}\n{END}{others.partition(END)[2]}"


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
