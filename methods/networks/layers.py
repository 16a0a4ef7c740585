"""Layers of a network and what they take from each other, read off one pass through it."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from unittest.mock import patch

import torch
from torch import Tensor, nn

from eitbench.methods.networks.image_network import Block


@dataclass(frozen=True)
class Layer:
    """A layer with parameters, or the input or output of a network.

    Attributes:
        name: path of its module in the network; "input" or "output".
        kind: description, such as "conv 2 × 2 ↓2", on a grid that is coarser by 2 afterwards.
        shape: of what it gives, without the samples: (C, h, w), (H, W) or (K,).
        parameters: how many it has; of the output, those that are in no layer.
        inputs: names of the layers that it takes from, through operations without parameters.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    parameters: int
    inputs: tuple[str, ...]


def layers(network: nn.Module, example: Tensor) -> list[Layer]:
    """The layers of `network` in the order of their computation, for a batch like `example`."""
    # Parts with a precision of their own would hide their layers in a graph of their own.
    with patch.object(torch, "autocast", lambda *_, **__: nullcontext()):
        graph = torch.export.export(network.eval(), (example,)).graph
    sources: dict[str, tuple[str, ...]] = {}  # layers behind each node of the graph
    found: dict[str, Layer] = {}
    for node in graph.nodes:
        behind = tuple(dict.fromkeys(s for a in node.all_input_nodes for s in sources[a.name]))
        name = _layer_of(network, node)
        if node.op == "placeholder":
            of_network = str(node.target).startswith(("p_", "b_"))
            if not of_network:
                found["input"] = Layer("input", "input", tuple(example.shape[1:]), 0, ())
            behind = () if of_network else ("input",)
        elif node.op == "output":
            shape = tuple(node.all_input_nodes[0].meta["val"].shape[1:])
            count = sum(p.numel() for p in network.parameters())
            rest = count - sum(layer.parameters for layer in found.values())
            found["output"] = Layer("output", "output", shape, rest, behind)
        elif name is not None:
            module = network.get_submodule(name)
            before = found[name].inputs if name in found else ()
            inputs = tuple(dict.fromkeys([*before, *(s for s in behind if s != name)]))
            count = sum(p.numel() for p in module.parameters())
            shape = tuple(node.meta["val"].shape[1:])
            found[name] = Layer(name, _kind(module), shape, count, inputs)
            behind = (name,)
        sources[node.name] = behind
    return list(found.values())


def _layer_of(network: nn.Module, node: torch.fx.Node) -> str | None:
    """The outermost module with parameters of its own, or residual block, that a node is in."""
    for path, _ in node.meta.get("nn_module_stack", {}).values():
        module = network.get_submodule(path)
        if path and (isinstance(module, Block) or [*module.parameters(recurse=False)]):
            return str(path)
    return None


def _kind(module: nn.Module) -> str:
    if isinstance(module, Block):
        return "residual block"
    if isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
        side, step = module.kernel_size[0], module.stride[0]
        arrow = "↑" if isinstance(module, nn.ConvTranspose2d) else "↓"
        return f"conv {side} × {side}" + (f" {arrow}{step}" if step > 1 else "")
    return "dense" if isinstance(module, nn.Linear) else type(module).__name__.lower()
