"""What `doctor` looks at for the recorder."""

from trigpoint.base.checks import Check


def checks() -> list[Check]:
    """Does the viewer have a display?"""
    from .viewer.process import has_display, program

    if not program().exists():
        remedy = "run: pip install -c constraints.txt --force-reinstall rerun-sdk"
        return [Check("rerun's viewer", "error", "its program is missing", remedy)]
    if not has_display():
        remedy = "give `view` and `review` the option --web"
        return [Check("rerun's viewer", "warning", "there is no display for its window", remedy)]
    return [Check("rerun's viewer", "ok", "can open a window")]
