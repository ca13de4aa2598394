#!/usr/bin/env python3
"""Writes LPIPS (Zhang et al. 2018) as an ONNX file for `eval.lpips`.

    pip install torch torchvision lpips onnx onnxscript
    python tools/lpips_onnx.py lpips_vgg.onnx            # VGG 16; --net alex: AlexNet, a tenth of the time
    trimip-cli eval RUN --set eval.lpips=lpips_vgg.onnx  # a build with --features lpips

The file has two inputs, `rendered` and `target`, of shape (1, 3, height, width): red, green and blue planes in [-1, 1], with at
least 32 pixels per side. Its output is one number, the distance. The package `lpips` contains the weights of the distance;
torchvision downloads those of the network.

`--check` needs no download: it compares the exported file with PyTorch at two sizes, using random weights. It evaluates the file with
onnxruntime or, if that is not installed, with onnx's own evaluator, which takes minutes. `--random` writes a file with random weights.
"""

import argparse
import sys

import torch


def network(net: str, random: bool) -> torch.nn.Module:
    """Returns the distance as a module that takes two pictures; with `random`, all weights are random."""
    import lpips

    torch.manual_seed(0)
    module = lpips.LPIPS(net=net, pretrained=not random, pnet_rand=random, verbose=False)
    if random:
        # The weights of the distance must not be negative.
        for layer in module.lins:
            for weights in layer.parameters():
                torch.nn.init.uniform_(weights, 0.0, 1.0)

    class Distance(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.module = module.eval()

        def forward(self, rendered, target):
            return self.module(rendered, target).reshape(())

    return Distance().eval()


def export(distance: torch.nn.Module, path: str) -> None:
    """Writes the module as an ONNX file with variable height and width."""
    pictures = tuple(torch.zeros(1, 3, 64, 64) for _ in range(2))
    axes = {2: "height", 3: "width"}
    torch.onnx.export(
        distance,
        pictures,
        path,
        input_names=["rendered", "target"],
        output_names=["distance"],
        dynamic_axes={"rendered": axes, "target": axes},
        opset_version=17,
        dynamo=False,
    )


def evaluator(path: str):
    """Returns a function that evaluates the file on two arrays."""
    try:
        import onnxruntime

        session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    except ImportError:
        from onnx.reference import ReferenceEvaluator

        session = ReferenceEvaluator(path)
    return lambda a, b: float(session.run(None, {"rendered": a, "target": b})[0])


def check(distance: torch.nn.Module, path: str) -> None:
    """Compares the file with PyTorch, and exits with an error if they differ."""
    compute = evaluator(path)
    for height, width in [(64, 64), (50, 71)]:
        a, b = (2.0 * torch.rand(1, 3, height, width) - 1.0 for _ in range(2))
        with torch.no_grad():
            expected = float(distance(a, b))
        found, same = compute(a.numpy(), b.numpy()), compute(a.numpy(), a.numpy())
        print(f"{width} x {height}: {found:.6f} in ONNX, {expected:.6f} in PyTorch, {same:.6f} for equal pictures")
        if abs(found - expected) > 1e-4 * max(1.0, abs(expected)) or abs(same) > 1e-5:
            sys.exit("the file differs from PyTorch")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", help="the ONNX file to write")
    parser.add_argument("--net", choices=["vgg", "alex"], default="vgg", help="the network [vgg]")
    parser.add_argument("--random", action="store_true", help="random weights, of no use but to try the program")
    parser.add_argument("--check", action="store_true", help="random weights, and a comparison with PyTorch")
    arguments = parser.parse_args()
    distance = network(arguments.net, arguments.random or arguments.check)
    export(distance, arguments.out)
    if arguments.check:
        check(distance, arguments.out)
    print(f"{arguments.out} is written")


if __name__ == "__main__":
    main()
