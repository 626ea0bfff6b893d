"""The wire: keys, messages, errors, codec, access, robot descriptors."""
