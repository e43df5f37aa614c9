"""What tests share: `from tests.helpers.NAME import …`."""
