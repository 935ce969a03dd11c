"""The rotation test as it runs: sequences found, operator's errors, accuracy so far, and what to do next."""
