"""Benchmarks, one experiment a file, each run by ``mixer bench``.

Each module has ``main(argv)`` with ``--out`` and ``--quick``, writes rows first, and makes tables
and figures from the rows alone.
"""
