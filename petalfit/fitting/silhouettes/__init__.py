"""Joint fits of several observations, above all of silhouettes."""
