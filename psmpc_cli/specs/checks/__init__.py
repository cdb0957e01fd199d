"""What must hold between the parts of a description; every check takes a document that may be wrong elsewhere."""
