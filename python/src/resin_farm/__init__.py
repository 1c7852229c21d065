"""Measures how translucent resins scatter and absorb light, from photographs of a blurred edge.

    import resin_farm

    with resin_farm.Farm() as farm:
        farm.submit()                            # the paper's dictionary, half a minute on two cores
        print(farm.measure("white.csv"))         # media with error bars

Lengths are in mm, coefficients in 1/mm. Profiles are radiance factors: ratios to a perfect white Lambertian surface in
air under the same light.
"""

from importlib import metadata

from resin_farm.capture import Capture
from resin_farm.channel_fit import (
    Candidate,
    ChannelFit,
    Curves,
    Likelihood,
    NuisanceEstimate,
    Refined,
    SceneEstimate,
    SourceShare,
)
from resin_farm.design import Design, HalfWidths, SlabSet
from resin_farm.dictionary import Dictionary
from resin_farm.errors import Deleted, FarmError, InvalidArgument, NotFound, NotInstalled, Refused, Unavailable
from resin_farm.farm import Farm
from resin_farm.grid import Grid
from resin_farm.maps import DistanceMap
from resin_farm.measurement import MeasuredProfile, Measurement, MeasurementWarning, read_measurements
from resin_farm.medium import Interval, Medium, SecondLobe
from resin_farm.options import FitOptions
from resin_farm.prints import Prediction, PrintColour, Reflectance, predict
from resin_farm.profile import Profile, simulate
from resin_farm.results import MaterialFit, Measured, ScaleCurve

__version__ = metadata.version("resin-farm")

__all__ = [
    "Candidate",
    "Capture",
    "ChannelFit",
    "Curves",
    "Deleted",
    "Design",
    "Dictionary",
    "DistanceMap",
    "Farm",
    "FarmError",
    "FitOptions",
    "Grid",
    "HalfWidths",
    "Interval",
    "InvalidArgument",
    "Likelihood",
    "MaterialFit",
    "Measured",
    "MeasuredProfile",
    "Measurement",
    "MeasurementWarning",
    "Medium",
    "NotFound",
    "NotInstalled",
    "NuisanceEstimate",
    "Prediction",
    "PrintColour",
    "Profile",
    "Refined",
    "Reflectance",
    "Refused",
    "ScaleCurve",
    "SceneEstimate",
    "SecondLobe",
    "SlabSet",
    "SourceShare",
    "Unavailable",
    "predict",
    "read_measurements",
    "simulate",
]
