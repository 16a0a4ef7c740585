"""Forward physics: meshes, elements, the complete electrode model, sensitivities."""

from eitbench.scenarios.physics.forward import ForwardModel, forward_model
from eitbench.scenarios.physics.mesh import Mesh, build_mesh

__all__ = ["ForwardModel", "Mesh", "build_mesh", "forward_model"]
