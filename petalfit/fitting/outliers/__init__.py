"""Points that do not belong to the surface: losses, mixtures, annealing."""
