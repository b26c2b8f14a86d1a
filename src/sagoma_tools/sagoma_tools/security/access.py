"""What a process of the graph may publish, subscribe to, offer and call: observed in the running graph, as DDS says it.

DDS Security 1.1 (OMG formal/18-04-01), clause 9.4, has the formats of governance and permissions; names of topics and
services in DDS are those of ROS 2's design article "Topic and Service name mapping to DDS".
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from xml.sax.saxutils import escape

from rclpy.node import Node

EVERYBODY = ("ros_discovery_info", "rt/rosout", "rt/parameter_events")  # what rmw and every node needs
PERSONS = "rt/mocap/bodies/*"  # come and go with the persons
PROTECTED = "ENCRYPT"
NAMESPACES = {
    "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
    "xsi:noNamespaceSchemaLocation": "http://www.omg.org/spec/DDS-SECURITY/20170901/{schema}",
}


@dataclass(frozen=True)
class Access:
    """DDS topics that a process may write and read; ``*`` stands for any characters."""

    writes: frozenset[str] = frozenset(EVERYBODY)
    reads: frozenset[str] = frozenset(EVERYBODY)

    def __or__(self, other: Access) -> Access:
        return Access(self.writes | other.writes, self.reads | other.reads)


ANYTHING = Access(frozenset({"*"}), frozenset({"*"}))


def access_of_node(node: Node, name: str) -> Access:
    """Return what the node with this full name does in the graph that ``node`` sees."""
    namespace, _, base = name.rpartition("/")
    of = base, namespace or "/"
    writes = {f"rt{topic}" for topic, _ in node.get_publisher_names_and_types_by_node(*of)}
    reads = {f"rt{topic}" for topic, _ in node.get_subscriber_names_and_types_by_node(*of)}
    for service, _ in node.get_service_names_and_types_by_node(*of):
        reads.add(f"rq{service}Request")
        writes.add(f"rr{service}Reply")
    for service, _ in node.get_client_names_and_types_by_node(*of):
        writes.add(f"rq{service}Request")
        reads.add(f"rr{service}Reply")
    persons = {PERSONS} if any(topic.startswith("rt/mocap/") for topic in writes) else set()
    return Access() | Access(frozenset(writes | persons), frozenset(reads))


def governance_xml(domain_id: int) -> str:
    """Return the rules of a domain: nobody without a certificate, everything encrypted, every access checked."""
    return _document(
        "dds",
        "omg_shared_ca_governance.xsd",
        f"""  <domain_access_rules>
    <domain_rule>
      <domains><id>{domain_id}</id></domains>
      <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
      <enable_join_access_control>true</enable_join_access_control>
      <discovery_protection_kind>{PROTECTED}</discovery_protection_kind>
      <liveliness_protection_kind>{PROTECTED}</liveliness_protection_kind>
      <rtps_protection_kind>SIGN</rtps_protection_kind>
      <topic_access_rules>
        <topic_rule>
          <topic_expression>*</topic_expression>
          <enable_discovery_protection>true</enable_discovery_protection>
          <enable_liveliness_protection>true</enable_liveliness_protection>
          <enable_read_access_control>true</enable_read_access_control>
          <enable_write_access_control>true</enable_write_access_control>
          <metadata_protection_kind>{PROTECTED}</metadata_protection_kind>
          <data_protection_kind>{PROTECTED}</data_protection_kind>
        </topic_rule>
      </topic_access_rules>
    </domain_rule>
  </domain_access_rules>
""",
    )


def permissions_xml(enclave: str, access: Access, domain_id: int, valid: tuple[datetime, datetime]) -> str:
    """Return what the holder of the enclave's certificate may do; everything else is denied."""
    begin, end = (instant.strftime("%Y-%m-%dT%H:%M:%S") for instant in valid)
    return _document(
        "dds",
        "omg_shared_ca_permissions.xsd",
        f"""  <permissions>
    <grant name="{escape(enclave)}">
      <subject_name>CN={escape(enclave)}</subject_name>
      <validity><not_before>{begin}</not_before><not_after>{end}</not_after></validity>
      <allow_rule>
        <domains><id>{domain_id}</id></domains>
        <publish>
          <topics>
{_topics(access.writes)}
          </topics>
        </publish>
        <subscribe>
          <topics>
{_topics(access.reads)}
          </topics>
        </subscribe>
      </allow_rule>
      <default>DENY</default>
    </grant>
  </permissions>
""",
    )


def _topics(names: Iterable[str]) -> str:
    return "\n".join(f"            <topic>{escape(name)}</topic>" for name in sorted(names))


def _document(root: str, schema: str, body: str) -> str:
    attributes = " ".join(f'{key}="{value.format(schema=schema)}"' for key, value in NAMESPACES.items())
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<{root} {attributes}>\n{body}</{root}>\n'
