"""One pair as a page of HTML that holds all it shows, and a 3D view of clouds for such pages."""
