"""The paper's tables in printed digits, and its noise study."""
