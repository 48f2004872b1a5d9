"""Keys of hidden machines, and the judge of blind tests."""
