"""What knows a wavelength: waters, cameras, and the medium that comes of them."""
