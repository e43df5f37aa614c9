from .clip_fid.motions import clip_fid as clip_fid
from .detail import detail_profile as detail_profile
from .torch_metrics.metrics import FID as FID
from .torch_metrics.metrics import ClipFID as ClipFID
from .torch_metrics.metrics import DeclaredMean as DeclaredMean
from .torch_metrics.metrics import RPrecision as RPrecision
