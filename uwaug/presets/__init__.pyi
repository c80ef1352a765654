from .files import list_presets as list_presets
from .preset import load_preset as load_preset
