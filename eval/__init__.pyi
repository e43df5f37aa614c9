from .clip_fid.score import clip_fid as clip_fid
from .detail import detail_profile as detail_profile
from .torch_metrics import ClipFID as ClipFID
from .torch_metrics import DeclaredMean as DeclaredMean
from .torch_metrics import RPrecision as RPrecision
