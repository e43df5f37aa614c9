"""Stores and runs on the Hugging Face Hub: what is pushed, with which card; what is pulled, checked (docs/hub.md)."""
