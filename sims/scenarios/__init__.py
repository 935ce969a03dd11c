"""Scenarios and plan files as TOML, and the simulation of one."""
