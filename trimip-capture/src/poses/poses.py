"""Runs one stage of pose estimation with pycolmap, of any version since 0.4: `poses.py STAGE JSON`, called by
`trimip-cli capture` in the folder of the capture. Functions and options that the version lacks are left out.
"""

import json
import sys

import pycolmap


def made(names, **values):
    """Returns an object of the first of these classes that pycolmap has, and sets the values that this class has; None without a class."""
    for name in names:
        kind = getattr(pycolmap, name, None)
        if kind is None:
            continue
        options = kind()
        for key, value in values.items():
            if value is not None and hasattr(options, key):
                setattr(options, key, value)
        return options
    return None


def call(function, *required, **optional):
    """Calls a function. Passes only those optional arguments that the signature in the first line of its documentation names."""
    known = (function.__doc__ or "").split("->")[0]
    given = {key: value for key, value in optional.items() if value is not None and f"{key}:" in known}
    return function(*required, **given)


def device(o):
    kinds = getattr(pycolmap, "Device", None)
    return kinds and (kinds.auto if o["gpu"] else kinds.cpu)


def features(o):
    common = dict(use_gpu=o["gpu"], num_threads=o["threads"], max_image_size=o["max_image_size"])
    call(
        pycolmap.extract_features,
        o["database"],
        o["images"],
        camera_mode=getattr(pycolmap.CameraMode, o["camera_mode"]),
        camera_model=o["camera_model"],
        reader_options=made(["ImageReaderOptions"], camera_model=o["camera_model"]),
        extraction_options=made(["FeatureExtractionOptions"], **common),
        sift_options=made(["SiftExtractionOptions"], **common),
        device=device(o),
    )


def match(function, o, pairing):
    """Calls a matcher. Its argument for the options of the pairs is `pairing_options` or `matching_options`, depending on the version."""
    common = dict(use_gpu=o["gpu"], num_threads=o["threads"])
    later = hasattr(pycolmap, "FeatureMatchingOptions")
    call(
        function,
        o["database"],
        matching_options=made(["FeatureMatchingOptions"], **common) if later else pairing,
        pairing_options=pairing,
        sift_options=None if later else made(["SiftMatchingOptions"], **common),
        device=device(o),
    )


def exhaustive(o):
    match(pycolmap.match_exhaustive, o, None)


def sequential(o):
    names = ["SequentialPairingOptions", "SequentialMatchingOptions"]
    tree = o["vocab_tree"]
    values = dict(overlap=o["overlap"], quadratic_overlap=True, loop_detection=tree is not None, vocab_tree_path=tree)
    match(pycolmap.match_sequential, o, made(names, **values))


def vocabulary(o):
    names = ["VocabTreePairingOptions", "VocabTreeMatchingOptions"]
    match(pycolmap.match_vocabtree, o, made(names, vocab_tree_path=o["vocab_tree"]))


def pairs(o):
    function = getattr(pycolmap, "match_image_pairs", None)
    options = made(["ImportedPairingOptions", "ImagePairsMatchingOptions"], match_list_path=o["list"])
    if function is None or options is None:
        print("this version compares no pairs of a list", flush=True)
        return
    match(function, o, options)


def said(models):
    """Prints COLMAP's message for no model, which the caller does not treat as a failure of the program."""
    if not models:
        print("failed to create sparse model", flush=True)


def incremental(o):
    values = dict(num_threads=o["threads"], ba_refine_extra_params=o["distortion"])
    options = made(["IncrementalPipelineOptions", "IncrementalMapperOptions"], **values)
    said(call(pycolmap.incremental_mapping, o["database"], o["images"], o["models"], options=options))


def global_(o):
    options = made(["GlobalPipelineOptions"], num_threads=o["threads"])
    said(call(pycolmap.global_mapping, o["database"], o["images"], o["models"], options=options))


STAGES = {
    "features": features,
    "exhaustive": exhaustive,
    "sequential": sequential,
    "vocabulary": vocabulary,
    "pairs": pairs,
    "incremental": incremental,
    "global": global_,
}

# Log messages go to this process's output instead of separate files.
logging = getattr(pycolmap, "logging", None)
for name in ["logtostderr", "alsologtostderr"]:
    if hasattr(logging, name):
        setattr(logging, name, True)
STAGES[sys.argv[1]](json.loads(sys.argv[2]))
