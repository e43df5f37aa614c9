from .reader import Store as Store
from .schema import RefusedMotion as RefusedMotion
from .writer import StoreWriter as StoreWriter
