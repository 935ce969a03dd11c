"""Optimal design of rotation tests: executable sequences, their information, and plans for given targets or times."""
