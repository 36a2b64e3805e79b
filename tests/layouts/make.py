"""Small files of HDF5's newer layouts and links, beside this script. Needs h5py 3.16 or newer, built with HDF5 2.0."""

import os

import h5py
import numpy

HERE = os.path.dirname(os.path.abspath(__file__))
WEIGHTS = numpy.array([[2, 4], [6, 8]], dtype=numpy.float32)


def netx(name, fill, libver="earliest"):
    """A dense layer of netx whose other members `fill` adds."""
    with h5py.File(os.path.join(HERE, name), "w", libver=libver) as file:
        layer = file.create_group("layer/0")
        layer["type"], layer["shape"] = numpy.array([b"dense"]), numpy.array([2])
        neuron = layer.create_group("neuron")
        neuron["type"] = numpy.array([b"CUBA"])
        for key, value in dict(iDecay=1024, vDecay=128, vThMant=80).items():
            neuron[key] = value
        fill(layer)


def weights(**how):
    return lambda layer: layer.create_dataset("weight", data=WEIGHTS, **how)


def linked(key, link):
    def fill(layer):
        if key != "weight":
            layer["weight"] = WEIGHTS
        layer[key] = link

    return fill


def virtual(layer):
    with h5py.File(os.path.join(HERE, "part"), "w") as file:
        file["w"] = WEIGHTS
    layout = h5py.VirtualLayout(shape=(2, 2), dtype="f4")
    layout[:] = h5py.VirtualSource("part", "w", shape=(2, 2))
    layer.create_virtual_dataset("weight", layout)


def nir(name, kind):
    """A layer of NIR with weights of 16 bits."""
    with h5py.File(os.path.join(HERE, name), "w") as file:
        node = file.create_group("node")
        node["type"] = "NIRGraph"
        node["edges"] = numpy.array([["i", "w"], ["w", "n"], ["n", "o"]], dtype="S1")
        nodes = node.create_group("nodes")
        for key, members in dict(
            i=dict(type="Input", shape=numpy.array([2])),
            w=dict(type="Linear"),
            n=dict(type="LIF", tau=numpy.full(2, 0.008), r=numpy.full(2, 8.0), v_leak=numpy.zeros(2), v_threshold=numpy.ones(2)),
            o=dict(type="Output", shape=numpy.array([2])),
        ).items():
            group = nodes.create_group(key)
            for field, value in members.items():
                group[field] = value
        values = numpy.array([[0.5, -0.25], [1.5, 3.0]])
        space = h5py.h5s.create_simple((2, 2))
        dataset = h5py.h5d.create(nodes["w"].id, b"weight", kind, space)
        dataset.write(space, space, values)


half = h5py.h5t.IEEE_F16LE
brain = h5py.h5t.IEEE_F16LE.copy()
brain.set_fields(15, 7, 8, 0, 7)
brain.set_ebias(127)
nir("nir_float16", half)
nir("nir_float16_big_endian", h5py.h5t.IEEE_F16BE)
nir("nir_bfloat16", brain)
netx("chunks_implicit", weights(chunks=(1, 1)), "latest")
netx("chunks_extensible", weights(chunks=(1, 2), maxshape=(None, 2)), "latest")
netx("layout_5", weights(chunks=(1, 2), compression="gzip"), "latest")
netx("chunks_b_tree_2", weights(chunks=(1, 1), maxshape=(None, None)), "latest")
netx("virtual", virtual, "latest")
netx("soft_weight", linked("weight", h5py.SoftLink("/elsewhere")))
netx("soft_bias", linked("bias", h5py.SoftLink("/elsewhere")), "latest")
netx("external_bias", linked("bias", h5py.ExternalLink("other.h5", "/bias")))
netx("external_bias_latest", linked("bias", h5py.ExternalLink("other.h5", "/bias")), "latest")
