"""The type checker of the tests: beartype, to which an int is a float, as it is to Python.

Where beartype is not installed, as on a machine that is borrowed for its GPU, nothing is checked.
"""

from importlib.util import find_spec

if find_spec("beartype"):
    from beartype import BeartypeConf, beartype

    check = beartype(conf=BeartypeConf(is_pep484_tower=True))
else:

    def check(function):
        return function
