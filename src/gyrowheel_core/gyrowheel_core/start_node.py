"""How the process of a node begins: ``python3 -P -m gyrowheel_core.start_node MODULE ARGUMENTS``.

What a node imports it uses until it ends. So nothing is collected while it imports, which takes a tenth of its start,
and the garbage collector leaves all of that alone afterwards. A node that is interrupted before it is there just ends.
"""

from __future__ import annotations

import gc
import signal
import sys
from importlib import import_module


def main() -> int:
    """Import the module that the first argument names, and run its ``main`` with the others."""
    if len(sys.argv) < 2:
        sys.stderr.write("usage: python3 -m gyrowheel_core.start_node MODULE ARGUMENTS\n")
        return 2
    # not where the parent has it ignored
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if usual:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    gc.disable()
    run = import_module(sys.argv.pop(1)).main
    gc.freeze()
    gc.enable()
    if usual and signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    code: int = run()
    return code


if __name__ == "__main__":
    raise SystemExit(main())
