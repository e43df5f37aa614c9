"""Operations on existing stores: remove, compact, merge, migrate, split."""
