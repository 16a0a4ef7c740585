"""Forward physics: meshes, elements, the complete electrode model, sensitivities."""
