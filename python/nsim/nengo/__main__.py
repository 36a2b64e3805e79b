"""`python -m nsim.nengo script.py ARGUMENTS..`: runs a script of nengo-loihi on nsim."""

import os
import runpy
import sys

from nsim.nengo import install

if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
    sys.exit("usage: python -m nsim.nengo SCRIPT [ARGUMENTS..]")
script = sys.argv[1]
if not os.path.exists(script):
    sys.exit(f"python -m nsim.nengo: there is no script '{script}'")
install()
sys.argv = sys.argv[1:]
sys.path[0] = os.path.dirname(os.path.abspath(script))
runpy.run_path(script, run_name="__main__")
