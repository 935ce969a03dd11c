"""Design of rotation tests: which sequences a fixture can execute, what they show, and which to run for how long."""
