"""The command's entry, under a name of its own: is what is imported as `compass`, `fusion`, `nodes` really ours?

These names are taken on the package index, too. A package of the same name that comes first on the path, or was
installed over ours, would end in an import error that names neither.
"""

from __future__ import annotations

import sys
from importlib import import_module, metadata, util

DISTRIBUTION = "visual-compass"


def main() -> int:
    """Entry point of ``visual-compass``."""
    try:
        check_packages("compass", "fusion")
        from fusion.offline.cli import main as command

        return command()
    except KeyboardInterrupt:  # while the command loads, or again while it ends
        print(f"{DISTRIBUTION}: interrupted", file=sys.stderr)
        return 130


def check_packages(*names: str) -> None:
    """Leave the process, with one line on the screen, where a package of one of the names is somebody else's."""
    for name in names:
        try:
            ours = getattr(import_module(name), "__distribution__", None) == DISTRIBUTION
        except Exception:  # whatever a foreign package does when it is imported
            ours = False
        if not ours:
            sys.exit(f"{DISTRIBUTION}: {_foreign(name)}")


def _foreign(name: str) -> str:
    """Who is in the way, and what to do."""
    spec = util.find_spec(name)
    if spec is None:
        return f"its package {name!r} is not installed; install {DISTRIBUTION} again"
    place = spec.origin or ", ".join(spec.submodule_search_locations or ["nowhere"])
    owners = [one for one in metadata.packages_distributions().get(name, []) if one != DISTRIBUTION]
    cure = f"pip uninstall {owners[0]}, then install {DISTRIBUTION} again" if owners else "take it off the Python path"
    return f"the package {name!r} in {place} is another one of that name; {cure}, or use an environment of its own"


if __name__ == "__main__":
    sys.exit(main())
