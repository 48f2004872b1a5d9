"""Hidden machines and effects of blind tests; no search for effects reads them."""
