"""Mathematical models of the papers: sensor model, analytic platform, measurement model, closed form, Table 1."""
