from .codec import RefusedMotion as RefusedMotion
from .reader import Store as Store
from .writer import StoreWriter as StoreWriter
