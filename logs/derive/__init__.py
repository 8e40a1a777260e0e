"""Topics that the recorder derives for viewers."""
