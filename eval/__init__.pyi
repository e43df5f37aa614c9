from .clip_fid.score import clip_fid as clip_fid
from .detail import detail_profile as detail_profile
