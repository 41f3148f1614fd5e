"""Effects: systematic errors beyond sensitivity and bias, from the catalogue or defined by the user."""

import lazy_loader

# Each name is loaded when it is first used. The names are listed in the stub file __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
