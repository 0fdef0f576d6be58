"""Joint fits, of silhouettes above all."""
