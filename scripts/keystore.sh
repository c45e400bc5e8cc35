#!/usr/bin/env bash
# A keystore for secured nodes (SROS2), as `ros2 security create_keystore` and `create_enclave` lay it
# out, by openssl alone: for machines without ROS. Keys are ECDSA P-256, documents S/MIME; everything is
# encrypted, and each enclave may publish and subscribe to every ROS topic and service of the domain.
# Other than there, data_protection_kind is NONE: metadata_protection_kind ENCRYPT covers the data, and
# veneer's DDS cannot read both. What exists is kept: call it again for more enclaves.
#
#   scripts/keystore.sh FOLDER ENCLAVE...        scripts/keystore.sh keys /robot/veneer /robot/camera
#
# environment: ROS_DOMAIN_ID  the domain that the documents are for (0)
set -euo pipefail

[ $# -ge 1 ] || { sed -n '2,11s/^# \{0,1\}//p' "$0" >&2; exit 2; }
keystore=$1
shift
domain=${ROS_DOMAIN_ID:-0}
case $domain in *[!0-9]*) echo "ROS_DOMAIN_ID='$domain' is no number" >&2; exit 2 ;; esac
days=3650
umask 077
mkdir -p "$keystore"/{public,private,enclaves}
cd "$keystore"
config=$(mktemp)
trap 'rm -f "$config"' EXIT
# The system's own configuration would add extensions of its own.
printf '[req]\ndistinguished_name = name\n[name]\n' >"$config"

# key_and_request KEY SUBJECT: a new key, and the request for its certificate on standard output
key_and_request() {
    openssl req -config "$config" -new -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes \
        -keyout "$1" -subj "$2" 2>/dev/null
}
sign() { # DOCUMENT.xml
    openssl smime -sign -text -in "$1" -out "${1%.xml}.p7s" \
        -signer public/permissions_ca.cert.pem -inkey private/permissions_ca.key.pem
}

if [ ! -f public/ca.cert.pem ]; then
    key_and_request private/ca.key.pem /CN=sros2CA |
        openssl x509 -req -days "$days" -signkey private/ca.key.pem -out public/ca.cert.pem \
            -extfile <(echo 'basicConstraints = critical, CA:TRUE, pathlen:1') 2>/dev/null
    for role in identity permissions; do
        ln -sf ca.cert.pem "public/${role}_ca.cert.pem"
        ln -sf ca.key.pem "private/${role}_ca.key.pem"
    done
fi

if [ ! -f enclaves/governance.p7s ]; then
    cat >enclaves/governance.xml <<XML
<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
    xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_governance.xsd">
  <domain_access_rules>
    <domain_rule>
      <domains><id>$domain</id></domains>
      <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
      <enable_join_access_control>true</enable_join_access_control>
      <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
      <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
      <rtps_protection_kind>ENCRYPT</rtps_protection_kind>
      <topic_access_rules>
        <topic_rule>
          <topic_expression>*</topic_expression>
          <enable_discovery_protection>true</enable_discovery_protection>
          <enable_liveliness_protection>true</enable_liveliness_protection>
          <enable_read_access_control>true</enable_read_access_control>
          <enable_write_access_control>true</enable_write_access_control>
          <metadata_protection_kind>ENCRYPT</metadata_protection_kind>
          <data_protection_kind>NONE</data_protection_kind>
        </topic_rule>
      </topic_access_rules>
    </domain_rule>
  </domain_access_rules>
</dds>
XML
    sign enclaves/governance.xml
fi

for enclave in "$@"; do
    case $enclave in
    / | /*[!/a-zA-Z0-9_]* | *//* | /*/ | [!/]* | '')
        echo "'$enclave' is no name of an enclave, such as /robot/veneer" >&2
        exit 2
        ;;
    esac
    folder=enclaves$enclave
    [ ! -f "$folder/permissions.p7s" ] || continue
    mkdir -p "$folder"
    depth=$(tr -cd / <<<"$enclave" | wc -c)
    up=$(printf '../%.0s' $(seq "$depth"))
    ln -sf "$up../public/identity_ca.cert.pem" "$up../public/permissions_ca.cert.pem" "$folder/"
    ln -sf "${up}governance.p7s" "$folder/"
    key_and_request "$folder/key.pem" "/CN=${enclave//\//\\/}" |
        openssl x509 -req -days "$days" -CA public/identity_ca.cert.pem -CAkey private/identity_ca.key.pem \
            -set_serial "0x$(openssl rand -hex 16)" -out "$folder/cert.pem" \
            -extfile <(echo 'basicConstraints = CA:FALSE') 2>/dev/null
    from=$(date -u +%FT%TZ)
    until=$(date -u -d "@$(($(date +%s) + days * 86400))" +%FT%TZ)
    cat >"$folder/permissions.xml" <<XML
<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
    xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd">
  <permissions>
    <grant name="$enclave">
      <subject_name>CN=$enclave</subject_name>
      <validity><not_before>$from</not_before><not_after>$until</not_after></validity>
      <allow_rule>
        <domains><id>$domain</id></domains>
        <publish>
          <topics>
            <topic>ros_discovery_info</topic>
            <topic>rt/*</topic>
            <topic>rq/*Request</topic>
            <topic>rr/*Reply</topic>
          </topics>
        </publish>
        <subscribe>
          <topics>
            <topic>ros_discovery_info</topic>
            <topic>rt/*</topic>
            <topic>rq/*Request</topic>
            <topic>rr/*Reply</topic>
          </topics>
        </subscribe>
      </allow_rule>
      <default>DENY</default>
    </grant>
  </permissions>
</dds>
XML
    sign "$folder/permissions.xml"
done
