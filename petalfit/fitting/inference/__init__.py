"""What the data determine, and how sure that is."""
