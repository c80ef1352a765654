from .files import list_presets as list_presets
from .files import published_systems as published_systems
from .preset import Preset as Preset
from .preset import load_preset as load_preset
