"""The least-squares solver, and the filter that carries its solution on."""
