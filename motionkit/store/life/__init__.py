"""Operations on existing stores: remove, compact, merge, split."""
