"""Wrong setups: columns of a recording that cannot be what they are called, by what physics demands of them."""
