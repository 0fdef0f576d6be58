"""What petalfit is compared with: the tools that one would take otherwise, used as well as we can."""
