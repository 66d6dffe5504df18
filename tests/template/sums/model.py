"""A function of two numbers, and an effect with a parameter that may change and one that is fixed."""

from calib.problem.effect import Effect
from calib.problem.space import Parameter, ParameterSpace
from calib.structure.function_model import FunctionModel


def build():
    space = ParameterSpace((Parameter("a", 1.0, 0.0, 3.0), Parameter("b", 1.0, 0.0, 3.0)))
    return FunctionModel("sums", space, lambda v: {"s": v["a"] + v["b"]})


def bent(model):
    return lambda v: {"s": model.function(v)["s"] + v["bend"] * v["bend_at"] * v["bend_scale"]}


def library():
    magnitude = Parameter("bend", 0.0, -1.0, 1.0, prior_sd=0.5)
    more = (Parameter("bend_at", 1.0, 0.0, 2.0), Parameter("bend_scale", 2.0, 2.0, 2.0, distribution="fixed"))
    grid = ({"bend": 0.1, "bend_at": 1.0, "bend_scale": 2.0},)
    return (Effect("bend", "a bend", "It is straight.", "Bends.", magnitude, bent, nuisance=more, grid=grid),)
