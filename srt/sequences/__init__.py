"""Recordings prepared as sequences: stationary windows, manoeuvres, recognition, window means, unusable data."""
