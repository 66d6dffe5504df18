"""What the chain may lack: the effects that come with its model, and one of our own."""

from calib import Effect, Parameter
from models.five_mass_chain import chain_effects


def bracket(model):
    """The responses of any chain with a heavier mass 1."""

    def with_bracket(values):
        return model.function({**values, "m1": values["m1"] + values["bracket_mass_1"]})

    return with_bracket


def library():
    """All effects that the study looks for."""
    own = Effect(
        name="bracket_mass_1",
        title="Bracket on mass 1",
        phrase="a bracket on mass 1",
        lacks="Mass 1 was weighed without the bracket that holds the shaker's rod.",
        look_for="The bracket, its bolts and the end of the rod.",
        magnitude=Parameter("bracket_mass_1", 0.0, 0.0, 1.0, "kg", prior_sd=0.1),
        build=bracket,
    )
    return (*chain_effects(), own)
