"""Command ``radioloc largest``: print the largest residual of each path at the study's position."""

from radioloc.cli import JSON, STUDY, command, finish, output_folder


@command("largest", STUDY, JSON, *output_folder(), examples=("study.toml --out results",))
def largest(options):
    """Print the largest residual of each path."""
    import radioloc
    from radioloc_toys.largest_residuals import LargestResiduals
    from radioloc_toys.residual_limit import ResidualLimit

    study = radioloc.read_study(options.study)
    residuals = radioloc.compute_residuals(study).residuals
    paths, sizes_m = residuals.paths[:], abs(residuals.residual_m)
    largest_m = {path: float(sizes_m[paths == path].max()) for path in sorted({*paths})}
    limit = study.extensions.get("residual_limit", ResidualLimit(limit_m=1000.0))
    return finish(options, LargestResiduals(study.name, largest_m, limit.limit_m))
