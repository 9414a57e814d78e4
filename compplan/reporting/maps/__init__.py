"""Maps of deflection, stiffness and dexterity over the workspace."""
