"""How the process of a node begins: ``python3 -P -m gyrowheel_core.start_node MODULE ARGUMENTS``.

What a node imports it uses until it ends. So nothing is collected while it imports, which takes a tenth of its start,
and the garbage collector leaves all of that alone afterwards.
"""

from __future__ import annotations

import gc
import sys
from importlib import import_module


def main() -> int:
    """Import the module that the first argument names, and run its ``main`` with the others."""
    gc.disable()
    run = import_module(sys.argv.pop(1)).main
    gc.freeze()
    gc.enable()
    code: int = run()
    return code


if __name__ == "__main__":
    raise SystemExit(main())
