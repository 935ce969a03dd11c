"""Closed form: the papers' formulas, iterated, with their covariance and leave-one-out (Savage 2020, §§3-9)."""
